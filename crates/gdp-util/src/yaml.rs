//! Strict YAML files of people, and errors in their terms: the closest known key, and the line.

use serde::de::DeserializeOwned;
use serde_saphyr::Error;

/// Similarity (Jaro-Winkler) below which two words count as unrelated.
const ALIKE: f64 = 0.75;

/// Parses a text. The error ends with the line and the column, and quotes no line: a file that is
/// named by mistake may be a private key.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let options = serde_saphyr::options! { with_snippet: false };
    serde_saphyr::from_str_with_options(text, options).map_err(|error| describe(&error))
}

fn describe(error: &Error) -> String {
    let at = error.location().map(|at| format!(" at line {}, column {}", at.line(), at.column()));
    let at = at.unwrap_or_default();
    let (what, word, expected) = match error.without_snippet() {
        Error::SerdeUnknownField { field, expected, .. } => ("key", field, expected),
        Error::SerdeUnknownVariant { variant, expected, .. } => ("value", variant, expected),
        other => {
            let text = other.to_string();
            let is_tab = text.contains("tabs disallowed") || text.contains("found a tab");
            return if is_tab { format!("a tab; use spaces, because YAML allows no tabs here{at}") } else { text };
        }
    };
    match nearest(word, expected) {
        Some(meant) => format!("there is no {what} `{word}`; did you mean `{meant}`?{at}"),
        None => format!("there is no {what} `{word}`; there is {}{at}", expected.join(", ")),
    }
}

fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    let likeness = |known: &'a str| (strsim::jaro_winkler(&word.to_lowercase(), known), known);
    let best = known.iter().map(|known| likeness(known)).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 >= ALIKE).then_some(best.1)
}

#[cfg(test)]
#[path = "../tests/unit/yaml.rs"]
mod tests;
