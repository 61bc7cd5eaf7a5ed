//! The model of one direction of a link, from one end to the other.
//!
//! ```text
//!  push ─► queue, mark ─► rate ─► partition, loss, burst ─► corrupt, duplicate ─► delay, jitter, reorder ─► pop
//! ```
//!
//! A lost frame uses the rate of the link, as on the air; a duplicate does not. Each kind of fault
//! has its own random numbers. So duplicating some frames does not change which frames are lost.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::{Faults, Random};

/// One direction of a link. `T` represents a frame: often its bytes, in simulations less.
#[derive(Clone, Debug)]
pub struct Link<T> {
    faults: Faults,
    random: Streams,
    counts: Counts,
    /// Time at which the last accepted frame leaves the queue, in nanoseconds.
    busy_until: u64,
    /// Whether the link is in the bad state of the Gilbert–Elliott model.
    bad: bool,
    /// Arrival time of the last frame that was not reordered, in nanoseconds.
    in_order: u64,
    /// The number of the next frame. Of frames with the same arrival time, the first sent arrives
    /// first.
    next: u64,
    under_way: BinaryHeap<Reverse<UnderWay<T>>>,
}

/// A frame that has arrived at the other end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivery<T> {
    pub frame: T,
    /// The time of arrival, in nanoseconds.
    pub at: u64,
    /// Whether the frame met congestion. A test with real frames then sets their CE bits.
    pub marked: bool,
    /// A random number that chooses the changed bit, if the frame is corrupted
    /// ([`Delivery::damage`] does so for bytes).
    pub corrupted: Option<u64>,
}

/// Counters of frames. Frames under way count as what they will be. `sent` equals the sum of the
/// following five counters minus `duplicated`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub sent: u64,
    /// Number of delivered frames. A duplicated frame counts twice.
    pub delivered: u64,
    pub lost: u64,
    pub lost_in_bursts: u64,
    pub partitioned: u64,
    /// Number of frames that did not fit into the queue.
    pub overflowed: u64,
    pub duplicated: u64,
    /// Number of frames delayed by [`Reorder`](crate::Reorder), even if none overtook them. This
    /// and the next two counters include duplicates.
    pub reordered: u64,
    pub corrupted: u64,
    pub marked: u64,
    /// Size of all delivered frames, in bytes.
    pub bytes: u64,
}

#[derive(Clone, Debug)]
struct Streams {
    loss: Random,
    burst: Random,
    corrupt: Random,
    duplicate: Random,
    jitter: Random,
    reorder: Random,
}

#[derive(Clone, Debug)]
struct UnderWay<T> {
    number: u64,
    delivery: Delivery<T>,
}

impl<T: Clone> Link<T> {
    /// Creates a link.
    ///
    /// # Panics
    ///
    /// If a probability is outside 0..=1, the rate is 0, or there is a queue without a rate.
    pub fn new(faults: Faults, seed: u64) -> Self {
        faults.check();
        Self {
            faults,
            random: Streams::new(seed),
            counts: Counts::default(),
            busy_until: 0,
            bad: false,
            in_order: 0,
            next: 0,
            under_way: BinaryHeap::new(),
        }
    }

    /// Sends a frame of `bytes` bytes. `now` must never decrease between calls.
    pub fn push(&mut self, now: u64, frame: T, bytes: usize) {
        self.counts.sent += 1;
        let Some((left, marked)) = self.serialize(now, bytes) else {
            self.counts.overflowed += 1;
            return;
        };
        if self.is_lost(left) {
            return;
        }
        let copies = 1 + usize::from(self.random.duplicate.chance(self.faults.duplicate));
        self.counts.duplicated += copies as u64 - 1;
        for _ in 0..copies {
            self.send(left, frame.clone(), bytes, marked);
        }
    }

    /// Sets the faults for later frames. Frames under way keep their arrival times.
    ///
    /// # Panics
    ///
    /// As [`Link::new`].
    pub fn change(&mut self, faults: Faults) {
        faults.check();
        self.faults = faults;
    }

    /// Returns the next frame that has arrived by `now`, in the order of arrival.
    pub fn pop(&mut self, now: u64) -> Option<Delivery<T>> {
        self.next().filter(|at| *at <= now)?;
        self.under_way.pop().map(|Reverse(frame)| frame.delivery)
    }

    /// Returns the arrival time of the next frame.
    pub fn next(&self) -> Option<u64> {
        self.under_way.peek().map(|Reverse(frame)| frame.delivery.at)
    }

    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Queues a frame. Returns the time at which it leaves the queue and whether it is marked, or
    /// `None` if it does not fit.
    fn serialize(&mut self, now: u64, bytes: usize) -> Option<(u64, bool)> {
        let Some(rate) = self.faults.rate else { return Some((now, false)) };
        let begin = self.busy_until.max(now);
        let waiting = (u128::from(begin - now) * u128::from(rate)).div_ceil(8_000_000_000) as u64;
        if self.faults.queue.is_some_and(|queue| waiting + bytes as u64 > queue) {
            return None;
        }
        let takes = (bytes as u128 * 8_000_000_000).div_ceil(u128::from(rate)) as u64;
        self.busy_until = begin + takes;
        Some((self.busy_until, self.faults.mark_above.is_some_and(|most| waiting > most)))
    }

    /// Decides whether a frame is lost. Draws a number for every fault, so that no fault affects
    /// the others.
    fn is_lost(&mut self, left: u64) -> bool {
        let lost = self.random.loss.chance(self.faults.loss);
        let burst = self.faults.burst.is_some_and(|burst| {
            let turns = self.random.burst.chance(if self.bad { burst.leave } else { burst.enter });
            self.bad ^= turns;
            let lost = self.random.burst.chance(burst.loss);
            self.bad && lost
        });
        let counter = if self.faults.is_partitioned(left) {
            &mut self.counts.partitioned
        } else if burst {
            &mut self.counts.lost_in_bursts
        } else if lost {
            &mut self.counts.lost
        } else {
            return false;
        };
        *counter += 1;
        true
    }

    fn send(&mut self, left: u64, frame: T, bytes: usize, marked: bool) {
        let corrupted = self.random.corrupt.chance(self.faults.corrupt).then(|| self.random.corrupt.number());
        let jitter = self.random.jitter.up_to(self.faults.jitter);
        self.in_order = self.in_order.max(left + self.faults.delay + jitter);
        let mut at = self.in_order;
        if let Some(reorder) = self.faults.reorder
            && self.random.reorder.chance(reorder.probability)
        {
            at += self.random.reorder.up_to(reorder.by);
            self.counts.reordered += 1;
        }
        self.counts.delivered += 1;
        self.counts.bytes += bytes as u64;
        self.counts.corrupted += u64::from(corrupted.is_some());
        self.counts.marked += u64::from(marked);
        let delivery = Delivery { frame, at, marked, corrupted };
        self.under_way.push(Reverse(UnderWay { number: self.next, delivery }));
        self.next += 1;
    }
}

impl<T: AsMut<[u8]>> Delivery<T> {
    /// Changes one bit of a corrupted frame, from byte `from` on. The bytes before it never change.
    pub fn damage(&mut self, from: usize) {
        let Some(choice) = self.corrupted else { return };
        let Some(body) = self.frame.as_mut().get_mut(from..).filter(|body| !body.is_empty()) else { return };
        let bit = choice % (body.len() as u64 * 8);
        body[(bit / 8) as usize] ^= 1 << (bit % 8);
    }
}

impl Counts {
    /// Returns the number of frames that never arrived.
    pub fn missing(&self) -> u64 {
        self.lost + self.lost_in_bursts + self.partitioned + self.overflowed
    }
}

impl Streams {
    fn new(seed: u64) -> Self {
        let mut seeds = Random::new(seed);
        Self {
            loss: seeds.fork(),
            burst: seeds.fork(),
            corrupt: seeds.fork(),
            duplicate: seeds.fork(),
            jitter: seeds.fork(),
            reorder: seeds.fork(),
        }
    }
}

impl<T> UnderWay<T> {
    fn order(&self) -> (u64, u64) {
        (self.delivery.at, self.number)
    }
}

impl<T> PartialEq for UnderWay<T> {
    fn eq(&self, other: &Self) -> bool {
        self.order() == other.order()
    }
}

impl<T> Eq for UnderWay<T> {}

impl<T> PartialOrd for UnderWay<T> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for UnderWay<T> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.order().cmp(&other.order())
    }
}
