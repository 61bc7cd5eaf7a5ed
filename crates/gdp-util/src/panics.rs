//! A task or thread that panics ends the process, so that a supervisor starts it again.
//!
//! `tokio` and `std` catch the panic of a task or thread. The rest would live on without it: a
//! daemon that answers `status` and takes no link. What forwards in the kernel forwards on, and so
//! nothing is lost by an end.

use std::backtrace::{Backtrace, BacktraceStatus};
use std::panic::PanicHookInfo;

use crate::log;

/// That of a Rust program whose main thread panics.
const STATUS: i32 = 101;

/// From now on each panic is logged on one line and ends the process with status 101.
///
/// A hook, and not `panic = "abort"`: Cargo would compile every dependency of the tests twice, and
/// an abort leaves a core with private keys in it.
pub fn end_process() {
    std::panic::set_hook(Box::new(|panic| {
        log::write("ERROR", module_path!(), describe(panic));
        let backtrace = Backtrace::capture();
        if backtrace.status() == BacktraceStatus::Captured {
            backtrace.to_string().lines().for_each(|line| log::write("ERROR", module_path!(), line));
        }
        log::flush();
        // SAFETY: it ends the process at once and has no preconditions. No destructor and no
        // `atexit` handler runs, which could wait for the thread that panicked.
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

/// Panics as soon as the file exists that the environment's `GDP_TEST_PANIC` names; never without
/// it.
///
/// For tests that show what the panic of a task does to a program. Shipped programs do not have it.
#[cfg(debug_assertions)]
pub async fn inject() {
    let Some(file) = std::env::var_os("GDP_TEST_PANIC") else { return };
    while !std::path::Path::new(&file).exists() {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    panic!("injected by {}", file.display());
}
