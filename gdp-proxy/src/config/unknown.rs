//! What is said of a file that is not understood: for a key or a word that is not known, the one that was probably meant.

use serde_saphyr::Error;

/// Words that are less alike than this have nothing to do with each other (Jaro-Winkler).
const ALIKE: f64 = 0.75;

/// Ends with the line and the column.
pub fn say(error: &Error) -> String {
    let (what, word, expected) = match error.without_snippet() {
        Error::SerdeUnknownField { field, expected, .. } => ("key", field, expected),
        Error::SerdeUnknownVariant { variant, expected, .. } => ("value", variant, expected),
        other => return other.to_string(),
    };
    let place = error.location().map(|place| format!(" at line {}, column {}", place.line(), place.column()));
    let place = place.unwrap_or_default();
    match nearest(word, expected) {
        Some(meant) => format!("there is no {what} `{word}`; did you mean `{meant}`?{place}"),
        None => format!("there is no {what} `{word}`; there is {}{place}", expected.join(", ")),
    }
}

fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    let likeness = |known: &'a str| (strsim::jaro_winkler(&word.to_lowercase(), known), known);
    let best = known.iter().map(|known| likeness(known)).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 >= ALIKE).then_some(best.1)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::config::Config;

    #[test]
    fn a_misspelt_key_is_named_with_its_line_and_with_what_was_meant() {
        let text = |topic: &str| {
            format!(
                "version: 1\nidentity: a\nlinks: [{{to: 'eth://r0'}}]\ntopics:\n  - topic: /chatter\n    {topic}\n    card: c\n    cert: d\n"
            )
        };
        let cases = [
            ("dirction: out", "there is no key `dirction`; did you mean `direction`? at line 6, column 5"),
            ("Direction: out", "did you mean `direction`?"),
            ("max_hertz: 5", "did you mean `max_hz`?"),
            ("zzz: out", "there is no key `zzz`; there is topic, graph, type, direction, card,"),
            ("direction: inn", "there is no value `inn`; did you mean `in`? at line 6"),
            ("{direction: out, qos: {dept: 5}}", "did you mean `depth`?"),
        ];
        for (topic, expected) in cases {
            let topic = match topic.strip_prefix('{').and_then(|inner| inner.strip_suffix('}')) {
                Some(inner) => inner.replacen(", ", "\n    ", 1),
                None => topic.into(),
            };
            let refusal = Config::parse(&text(&topic), Path::new("p.yaml")).unwrap_err().to_string();
            assert!(refusal.starts_with("p.yaml: ") && refusal.contains(expected), "{refusal}");
            assert_eq!(refusal.lines().count(), 1);
        }
    }
}
