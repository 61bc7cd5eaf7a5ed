//! The datagrams that wait for TCP. The queue is bounded in bytes and in time, so congestion shows
//! as loss, as over UDP. No I/O.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp_wire::FrameType;

/// Maximum number of bytes in the queue.
const MAX_BYTES: usize = 1 << 20;

/// Maximum time for which a data frame waits. A newer message then has a chance to arrive in time.
pub const MAX_AGE: Duration = Duration::from_millis(100);

#[derive(Default)]
pub struct DatagramQueue {
    /// QUIC packets, echoes and error frames precede data frames, because they keep the link up.
    control: VecDeque<Bytes>,
    /// Data frames with the times of their arrival.
    data: VecDeque<(Instant, Bytes)>,
    bytes: usize,
}

impl DatagramQueue {
    /// Adds a datagram. When the queue is full, the oldest ones are dropped, data frames first.
    pub fn push(&mut self, now: Instant, datagram: Bytes) {
        while self.bytes + datagram.len() > MAX_BYTES {
            let oldest = self.data.pop_front().map(|(_, oldest)| oldest).or_else(|| self.control.pop_front());
            let Some(oldest) = oldest else { break };
            self.bytes -= oldest.len();
        }
        let Some(first) = datagram.first() else { return };
        self.bytes += datagram.len();
        match *first == FrameType::Data.first_byte() {
            true => self.data.push_back((now, datagram)),
            false => self.control.push_back(datagram),
        }
    }

    /// Returns the next datagram, and drops data frames that have waited too long.
    pub fn pop(&mut self, now: Instant) -> Option<Bytes> {
        if let Some(packet) = self.control.pop_front() {
            self.bytes -= packet.len();
            return Some(packet);
        }
        loop {
            let (since, frame) = self.data.pop_front()?;
            self.bytes -= frame.len();
            if now.saturating_duration_since(since) <= MAX_AGE {
                return Some(frame);
            }
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/tunnel/queue.rs"]
mod tests;
