//! Errors of the keys, certificates and cards of a route.

use std::fmt::Display;
use std::path::Path;

/// A file that does not meet the requirements of its key in the configuration.
#[derive(Debug, thiserror::Error)]
#[error("{key}: {reason}")]
pub struct MaterialError {
    /// The key in the configuration, such as `topics[0].cert`.
    pub key: String,
    pub reason: String,
}

/// Returns the reason with the file's path in front, unless the reason contains the path already.
pub fn with_path(reason: impl Display, path: &Path) -> String {
    let (reason, path) = (reason.to_string(), path.display().to_string());
    if reason.contains(&path) { reason } else { format!("{path}: {reason}") }
}
