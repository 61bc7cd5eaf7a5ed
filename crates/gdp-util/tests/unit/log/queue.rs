//! Unit tests of `log::queue`.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use super::*;

const LONG: Duration = Duration::from_secs(60);

#[test]
fn lines_are_written_in_order_and_flushed() {
    let (queue, output) = start(|_| Step::Take(usize::MAX));
    for i in 0..1000 {
        queue.push(format!("{i}\n").into_bytes());
    }
    queue.flush(LONG);
    let expected: String = (0..1000).map(|i| format!("{i}\n")).collect();
    assert_eq!(text(&output), expected);
}

#[test]
fn a_writer_that_stands_still_stops_nobody_and_costs_bounded_memory() {
    let (release, released) = channel::<()>();
    let (writes, first_write) = channel::<()>();
    let released = Mutex::new(released);
    let (queue, output) = start(move |_| {
        // Nobody waits for the later ones.
        let _ = writes.send(());
        // Until the sender is dropped.
        let _ = released.lock().unwrap().recv();
        Step::Take(usize::MAX)
    });
    let line = |i: usize| format!("{i:>1023}\n").into_bytes();
    queue.push(line(0));
    first_write.recv().unwrap();
    (1..5000).for_each(|i| queue.push(line(i)));
    assert!(queue.state().bytes <= CAPACITY);
    queue.flush(Duration::from_millis(10));
    drop(release);
    queue.flush(LONG);
    queue.push(b"more\n".to_vec());
    queue.flush(LONG);
    let text = text(&output);
    let lines: Vec<&str> = text.lines().map(str::trim).collect();
    let notices: Vec<u64> = lines.iter().filter_map(|line| line.strip_suffix(" dropped")?.parse().ok()).collect();
    let kept = lines.len() - notices.len() - 1;
    assert_eq!(notices.iter().sum::<u64>() as usize + kept, 5000);
    assert!((1024..=1026).contains(&kept), "{kept}");
    assert_eq!((lines[0], *lines.last().unwrap()), ("0", "more"));
}

#[test]
fn what_cannot_be_written_is_dropped_counted_and_never_runs_into_the_next_line() {
    // The disk takes two bytes of the second line, nothing of the third, and then there is room
    // again.
    let steps = [Step::Take(usize::MAX), Step::Take(2), Step::Fail(28), Step::Fail(28)];
    let (queue, output) = start(move |i| steps.get(i).copied().unwrap_or(Step::Take(usize::MAX)));
    for line in ["first\n", "second\n", "third\n", "fourth\n"] {
        queue.push(line.into());
        queue.flush(LONG);
    }
    assert_eq!(text(&output), "first\nse\n2 dropped\nfourth\n");
}

#[test]
fn a_call_that_is_interrupted_or_not_ready_is_made_again() {
    let steps = [Step::Fail(libc::EINTR), Step::Take(1), Step::Fail(libc::EAGAIN)];
    let (queue, output) = start(move |i| steps.get(i).copied().unwrap_or(Step::Take(usize::MAX)));
    queue.push(b"line\n".to_vec());
    queue.flush(LONG);
    assert_eq!(text(&output), "line\n");
}

/// What one call of `write` does.
#[derive(Clone, Copy)]
enum Step {
    /// So many bytes, at most.
    Take(usize),
    /// With this error.
    Fail(i32),
}

struct Output<F> {
    step: F,
    calls: usize,
    taken: Sender<Vec<u8>>,
}

impl<F: Fn(usize) -> Step> Write for Output<F> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.calls += 1;
        match (self.step)(self.calls - 1) {
            Step::Take(most) => {
                let count = bytes.len().min(most);
                self.taken.send(bytes[..count].to_vec()).unwrap();
                Ok(count)
            }
            Step::Fail(error) => Err(std::io::Error::from_raw_os_error(error)),
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn start(step: impl Fn(usize) -> Step + Send + 'static) -> (Arc<Queue>, Receiver<Vec<u8>>) {
    let (queue, (taken, output)) = (Arc::new(Queue::new()), channel());
    let written = queue.clone();
    std::thread::spawn(move || {
        let output = Output { step, calls: 0, taken };
        written.write_to(output, |count| format!("{count} dropped\n").into_bytes())
    });
    (queue, output)
}

fn text(output: &Receiver<Vec<u8>>) -> String {
    String::from_utf8(output.try_iter().flatten().collect()).unwrap()
}
