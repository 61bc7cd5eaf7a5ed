//! The XDP programs: the object inside this executable, or a named file.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::{fmt, io};

/// Environment variable that names a file to load instead of the embedded object; for development
/// and tests.
pub const ENVIRONMENT: &str = "GDP_EBPF_OBJECT";

// The build script generates `EMBEDDED: Option<&[u8]>`.
include!(concat!(env!("OUT_DIR"), "/embedded.rs"));

/// This executable contains no XDP programs, and no file was named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("built without XDP: `cargo xtask build` makes an executable with the XDP programs inside")]
pub struct BuiltWithoutXdp;

/// Source of the XDP programs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Object {
    /// Inside this executable.
    Embedded(&'static [u8]),
    File(PathBuf),
}

impl Object {
    /// Returns the file that the configuration names, else the file that the environment names,
    /// else the embedded object.
    pub fn find(wanted: Option<&Path>) -> Result<Self, BuiltWithoutXdp> {
        let named = wanted.map(PathBuf::from).or_else(|| std::env::var_os(ENVIRONMENT).map(PathBuf::from));
        match named {
            Some(file) => Ok(Self::File(file)),
            None => EMBEDDED.map(Self::Embedded).ok_or(BuiltWithoutXdp),
        }
    }

    /// Returns the ELF file.
    ///
    /// # Errors
    /// If a named file cannot be read. The error says how to run without a file.
    pub fn bytes(&self) -> io::Result<Cow<'static, [u8]>> {
        match self {
            Self::Embedded(bytes) => Ok(Cow::Borrowed(bytes)),
            Self::File(path) => std::fs::read(path).map(Cow::Owned).map_err(|error| {
                let remedy = "name no file, and `cargo xtask build` puts the XDP programs inside the executable";
                io::Error::new(error.kind(), format!("{error}; {remedy}"))
            }),
        }
    }
}

/// Returns whether this executable contains the XDP programs.
pub const fn is_embedded() -> bool {
    EMBEDDED.is_some()
}

impl fmt::Display for Object {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Embedded(_) => f.write_str("the XDP programs in this executable"),
            Self::File(path) => path.display().fmt(f),
        }
    }
}

impl<T: AsRef<Path> + ?Sized> From<&T> for Object {
    fn from(file: &T) -> Self {
        Self::File(file.as_ref().to_owned())
    }
}

#[cfg(test)]
#[path = "../tests/unit/object.rs"]
mod tests;
