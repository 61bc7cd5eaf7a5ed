//! The limit on open file descriptors of this process, and what connections leave for the rest.
//! Windows has no such limit.

#[cfg(not(unix))]
mod other;
#[cfg(unix)]
mod unix;

#[cfg(not(unix))]
pub use other::*;
#[cfg(unix)]
pub use unix::*;
