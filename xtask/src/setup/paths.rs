//! Returns the folders of toolchains.

use std::path::{Path, PathBuf};

pub fn home(variable: &str, default: &str) -> PathBuf {
    std::env::var_os(variable)
        .map(PathBuf::from)
        .unwrap_or_else(|| Path::new(&std::env::var_os("HOME").unwrap_or_default()).join(default))
}
