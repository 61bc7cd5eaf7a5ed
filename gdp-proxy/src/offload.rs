//! Runs long work outside of the worker threads, so that other tasks do not wait for it.

use tokio::runtime::{Handle, RuntimeFlavor};

/// To convert, compress or seal so many bytes takes longer than to hand other work to another
/// thread.
const LARGE: usize = 128 << 10;

/// Whether others are to be left to another thread while so many bytes are worked on.
pub fn is_large(bytes: usize) -> bool {
    let is_shared =
        || Handle::try_current().is_ok_and(|runtime| runtime.runtime_flavor() == RuntimeFlavor::MultiThread);
    bytes >= LARGE && is_shared()
}

/// Works on so many bytes. If that is large, what else this thread is to do is left to others
/// meanwhile.
pub fn run_blocking_if_large<T>(bytes: usize, work: impl FnOnce() -> T) -> T {
    if is_large(bytes) { tokio::task::block_in_place(work) } else { work() }
}
