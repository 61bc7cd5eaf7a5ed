//! Errors of the keys, certificates and cards of a route.

use std::fmt::Display;
use std::path::Path;

/// A file does not do for what the configuration wants of it.
#[derive(Debug, thiserror::Error)]
#[error("{key}: {reason}")]
pub struct MaterialError {
    /// `topics[0].cert`
    pub key: String,
    pub reason: String,
}

/// The reason with the file in front, unless it names the file already.
pub fn with_path(reason: impl Display, path: &Path) -> String {
    let (reason, path) = (reason.to_string(), path.display().to_string());
    if reason.contains(&path) { reason } else { format!("{path}: {reason}") }
}
