//! Errors for unknown keys and words of a file, with the closest known one.

use serde_saphyr::Error;

/// Similarity (Jaro-Winkler) below which two words count as unrelated.
const ALIKE: f64 = 0.75;

/// Returns the error's text, which ends with the line and the column.
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
#[path = "../../tests/unit/config/unknown.rs"]
mod tests;
