//! What differs between operating systems about files and users.
//!
//! Unix has modes and owners of files. Elsewhere none of these is checked or set.

#[cfg(not(unix))]
mod other;
#[cfg(unix)]
mod unix;

#[cfg(not(unix))]
pub use other::*;
#[cfg(unix)]
pub use unix::*;

#[cfg(test)]
#[path = "../../tests/unit/os.rs"]
mod tests;
