//! A bounded queue of lines for a writer that may fail or block. Pushing a line never waits.

use std::collections::VecDeque;
use std::io::{ErrorKind, Write};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Maximum size of all queued lines, in bytes, while the writer is blocked.
const CAPACITY: usize = 1 << 20;

/// Delay before another attempt if the output is not ready, such as a pipe that another process
/// made non-blocking.
const NOT_READY: Duration = Duration::from_millis(100);

/// A queue for many threads that push and one thread that writes.
pub struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    lines: VecDeque<Vec<u8>>,
    /// Size of `lines`, in bytes.
    bytes: usize,
    /// Number of lines dropped or not written since the last notice about them.
    dropped: u64,
    /// Whether the writer is writing a line that is no longer in `lines`.
    is_writing: bool,
}

impl Queue {
    pub const fn new() -> Self {
        let state = State { lines: VecDeque::new(), bytes: 0, dropped: 0, is_writing: false };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Queues a line, which ends with a line feed. Never blocks: drops the line if there is no
    /// room.
    pub fn push(&self, line: Vec<u8>) {
        let mut state = self.state();
        if state.bytes + line.len() > CAPACITY {
            state.dropped += 1;
            return;
        }
        state.bytes += line.len();
        state.lines.push_back(line);
        drop(state);
        self.changed.notify_all();
    }

    /// Waits until all lines are written or dropped, but at most for `limit`.
    pub fn flush(&self, limit: Duration) {
        let deadline = Instant::now() + limit;
        let mut state = self.state();
        while !state.lines.is_empty() || state.is_writing {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            state = self.changed.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Writes lines forever. `dropped` formats the notice about a number of missing lines.
    pub fn write_to(&self, mut output: impl Write, dropped: impl Fn(u64) -> Vec<u8>) -> ! {
        let mut is_torn = false;
        loop {
            let (line, missing) = self.next();
            let notice = (missing > 0).then(|| dropped(missing));
            let lines = notice.iter().chain([&line]);
            let mut written = Ok(());
            for line in lines {
                written = written.and_then(|()| write_line(&mut output, line, &mut is_torn));
            }
            let mut state = self.state();
            state.is_writing = false;
            if written.is_err() {
                state.dropped += missing + 1;
            }
            drop(state);
            self.changed.notify_all();
        }
    }

    /// Waits for the next line, and returns it with the number of lines dropped before it.
    fn next(&self) -> (Vec<u8>, u64) {
        let mut state = self.state();
        loop {
            if let Some(line) = state.lines.pop_front() {
                state.bytes -= line.len();
                state.is_writing = true;
                return (line, std::mem::take(&mut state.dropped));
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Writes a line. Begins a new line first if the last write was incomplete, as on a full disk.
fn write_line(output: &mut impl Write, line: &[u8], is_torn: &mut bool) -> Result<(), ErrorKind> {
    let end: &[u8] = if *is_torn { b"\n" } else { b"" };
    for mut rest in [end, line] {
        while !rest.is_empty() {
            match output.write(rest) {
                Ok(0) => return Err(ErrorKind::WriteZero),
                Ok(count) => {
                    rest = &rest[count..];
                    *is_torn = !rest.is_empty();
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::sleep(NOT_READY),
                Err(error) => return Err(error.kind()),
            }
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "../../tests/unit/log/queue.rs"]
mod tests;
