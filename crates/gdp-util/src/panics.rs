//! Ends the process when a task or thread panics, so that a supervisor restarts it.
//!
//! `tokio` and `std` catch the panic of a task or thread, and the process would continue without
//! it. A daemon could then answer `status` but accept no link. The data plane in the kernel keeps
//! forwarding, so ending the process loses nothing.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::panic::PanicHookInfo;

use crate::log;

/// Exit status of a Rust program whose main thread panics.
const STATUS: i32 = 101;

/// Installs a panic hook that logs each panic on one line and ends the process with status 101.
///
/// The alternative `panic = "abort"` has two drawbacks. Cargo would compile every dependency of the
/// tests twice, and an abort leaves a core file with private keys.
pub fn end_process() {
    std::panic::set_hook(Box::new(|panic| {
        log::write("ERROR", module_path!(), describe(panic));
        let backtrace = Backtrace::capture();
        if backtrace.status() == BacktraceStatus::Captured {
            backtrace.to_string().lines().for_each(|line| log::write("ERROR", module_path!(), line));
        }
        log::flush();
        // SAFETY: `_exit` ends the process at once and has no preconditions. It runs no destructor
        // and no `atexit` handler, which could wait for the panicking thread.
        unsafe { libc::_exit(STATUS) }
    }));
}

fn describe(panic: &PanicHookInfo<'_>) -> String {
    let thread = std::thread::current();
    let thread = thread.name().unwrap_or("without a name");
    let place = panic.location().map_or_else(String::new, |at| format!(" at {at}"));
    let what = panic.payload_as_str().unwrap_or("no message");
    format!("this program has a bug and ends: thread {thread} panicked{place}: {what}")
}

/// Panics as soon as the file exists that the environment variable `GDP_TEST_PANIC` names. Returns
/// if the variable is not set.
///
/// Tests use it to panic in a task of a program. Release builds do not contain it.
#[cfg(debug_assertions)]
pub async fn inject() {
    let Some(file) = std::env::var_os("GDP_TEST_PANIC") else { return };
    while !std::path::Path::new(&file).exists() {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    panic!("injected by {}", file.display());
}
