//! Lines on their way to a writer that may fail or stand still: bounded, and never waited for.

use std::collections::VecDeque;
use std::io::{ErrorKind, Write};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Bytes that may wait. A writer that stands still costs no more memory than this.
const CAPACITY: usize = 1 << 20;

/// How long a writer that is not ready is left alone: a pipe that another process made
/// non-blocking.
const NOT_READY: Duration = Duration::from_millis(100);

/// Many threads push, one thread writes.
pub struct Queue {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    lines: VecDeque<Vec<u8>>,
    /// Of `lines`.
    bytes: usize,
    /// Lines that found no room or could not be written, since this was last logged.
    dropped: u64,
    /// The writer is at a line that it has taken out of `lines`.
    is_writing: bool,
}

impl Queue {
    pub const fn new() -> Self {
        let state = State { lines: VecDeque::new(), bytes: 0, dropped: 0, is_writing: false };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }

    /// Never blocks: drops the line if there is no room for it. A line ends with a line feed.
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

    /// Waits until everything is written or dropped, for `limit` at most.
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

    /// Writes for ever. `dropped` makes the line that says how many lines are missing.
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

    /// The next line, and how many were dropped before it.
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

/// Begins a new line if the last one was cut off, as it is on a disk that becomes full.
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
