//! Version of the running kernel.

use std::ffi::CStr;
use std::fmt;

/// Major and minor version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct KernelVersion(pub u32, pub u32);

impl KernelVersion {
    /// Returns the running version, or 0.0 if the kernel does not report it.
    pub fn running() -> Self {
        // SAFETY: an all-zero `utsname` is valid, and uname fills it.
        let mut name: libc::utsname = unsafe { std::mem::zeroed() };
        // SAFETY: a valid pointer to a `utsname`.
        if unsafe { libc::uname(&mut name) } != 0 {
            return Self(0, 0);
        }
        // SAFETY: the kernel ends the text with a zero byte within the array.
        let release = unsafe { CStr::from_ptr(name.release.as_ptr()) };
        Self::parse(&release.to_string_lossy())
    }

    fn parse(release: &str) -> Self {
        let mut numbers = release.split(|c: char| !c.is_ascii_digit()).map(|part| part.parse().unwrap_or(0));
        Self(numbers.next().unwrap_or(0), numbers.next().unwrap_or(0))
    }
}

impl fmt::Display for KernelVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.0, self.1)
    }
}

#[cfg(test)]
#[path = "../tests/unit/kernel_version.rs"]
mod tests;
