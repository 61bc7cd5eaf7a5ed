//! Errors of DPDK calls.

use std::ffi::CStr;

use crate::sys;

/// A failed DPDK call, with DPDK's description of the error.
#[derive(Debug, thiserror::Error)]
#[error("{what}: {reason}{remedy}")]
pub struct DpdkError {
    pub what: String,
    /// A positive `errno`, or one of DPDK's own numbers.
    pub code: i32,
    reason: String,
    /// Possible remedy; empty if unknown.
    remedy: &'static str,
}

impl DpdkError {
    pub(crate) fn new(what: impl Into<String>, code: i32) -> Self {
        let code = code.abs();
        // SAFETY: for every number the call returns a string that lives as long as this thread.
        let reason = unsafe { CStr::from_ptr(sys::rte_strerror(code)) }.to_string_lossy().into_owned();
        Self { what: what.into(), code, reason, remedy: "" }
    }

    /// Creates the error of a call that reports its error in the thread's `rte_errno`.
    pub(crate) fn last(what: impl Into<String>) -> Self {
        // SAFETY: the call reads a number of this thread.
        Self::new(what, unsafe { sys::gdp_errno() })
    }

    pub(crate) fn with_remedy(self, remedy: &'static str) -> Self {
        Self { remedy, ..self }
    }

    /// Checks the result of a call that returns 0, or a negative number on failure.
    pub(crate) fn check(result: i32, what: impl FnOnce() -> String) -> Result<(), Self> {
        if result < 0 { Err(Self::new(what(), result)) } else { Ok(()) }
    }
}
