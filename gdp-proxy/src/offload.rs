//! Runs long work without blocking the other tasks of its worker thread.

use tokio::runtime::{Handle, RuntimeFlavor};

/// Size in bytes from which to convert, compress or seal a message takes longer than to move other
/// work to another thread.
const LARGE: usize = 128 << 10;

/// Whether work on `bytes` bytes should let other threads run this thread's other tasks. It is
/// false outside a multi-threaded runtime.
pub fn is_large(bytes: usize) -> bool {
    let is_shared =
        || Handle::try_current().is_ok_and(|runtime| runtime.runtime_flavor() == RuntimeFlavor::MultiThread);
    bytes >= LARGE && is_shared()
}

/// Runs `work` on `bytes` bytes. If that is large, other threads meanwhile run the other tasks of
/// this thread.
pub fn run_blocking_if_large<T>(bytes: usize, work: impl FnOnce() -> T) -> T {
    if is_large(bytes) { tokio::task::block_in_place(work) } else { work() }
}
