//! What DPDK refuses.

use std::ffi::CStr;

use crate::sys;

/// A call that failed, and why in DPDK's words.
#[derive(Debug, thiserror::Error)]
#[error("{what}: {reason}{remedy}")]
pub struct DpdkError {
    pub what: String,
    /// A positive `errno`, or one of DPDK's own numbers.
    pub code: i32,
    reason: String,
    /// What may be done about it; empty if nothing is known.
    remedy: &'static str,
}

impl DpdkError {
    pub(crate) fn new(what: impl Into<String>, code: i32) -> Self {
        let code = code.abs();
        // SAFETY: it gives a string that lives as long as this thread, for every number.
        let reason = unsafe { CStr::from_ptr(sys::rte_strerror(code)) }.to_string_lossy().into_owned();
        Self { what: what.into(), code, reason, remedy: "" }
    }

    /// Of a call that leaves its error where the thread's last one is.
    pub(crate) fn last(what: impl Into<String>) -> Self {
        // SAFETY: reads a number of this thread.
        Self::new(what, unsafe { sys::gdp_errno() })
    }

    pub(crate) fn with_remedy(self, remedy: &'static str) -> Self {
        Self { remedy, ..self }
    }

    /// Of a call that returns 0, or a negative number if it failed.
    pub(crate) fn check(result: i32, what: impl FnOnce() -> String) -> Result<(), Self> {
        if result < 0 { Err(Self::new(what(), result)) } else { Ok(()) }
    }
}
