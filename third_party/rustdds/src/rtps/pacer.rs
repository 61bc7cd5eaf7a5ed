//! Paces fragmented samples (GDP patch; see GDP-PATCH.md).
//!
//! A datagram to a reader of the same host lands in its socket buffer at once: the kernel pushes back on nobody. A
//! sample larger than that buffer (212 992 bytes by default, skb overhead included) must be sent in smaller bursts,
//! with time between them for the reader to take them out. There is one pacer for each participant, because the
//! readers behind one socket are often served by several of its writers.

use std::{
  cell::Cell,
  time::{Duration, Instant},
};

/// Bytes sent without a pause. Two such bursts, with the kernel's overhead, fit a default receive buffer.
const BURST: usize = 60 * 1024;

/// The pause that a burst costs: a bound of 550 MB/s.
const PAUSE: Duration = Duration::from_micros(120);

/// A token bucket, counted in time: a burst costs a [`PAUSE`], and one may be taken in advance, because timers are late.
#[derive(Debug)]
pub(crate) struct Pacer {
  left: Cell<usize>,
  paid_until: Cell<Instant>,
}

impl Pacer {
  pub fn new() -> Self {
    Self {
      left: Cell::new(BURST),
      paid_until: Cell::new(Instant::now()),
    }
  }

  /// How long to wait before the next fragment goes out, if at all.
  pub fn wait(&self) -> Option<Duration> {
    if self.left.get() > 0 {
      return None;
    }
    let now = Instant::now();
    let due = self.paid_until.get();
    if now < due {
      return Some(due - now);
    }
    self.left.set(BURST);
    None
  }

  /// A datagram of fragments went out.
  pub fn sent(&self, bytes: usize) {
    let left = self.left.get().saturating_sub(bytes);
    self.left.set(left);
    if left == 0 {
      let late = Instant::now() - PAUSE;
      self.paid_until.set(self.paid_until.get().max(late) + PAUSE);
    }
  }
}
