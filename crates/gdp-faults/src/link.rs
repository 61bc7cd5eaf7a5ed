//! Frames through one direction of a link.
//!
//! ```text
//!  push ─► queue, mark ─► rate ─► partition, loss, burst ─► corrupt, duplicate ─► delay, jitter, reorder ─► pop
//! ```
//!
//! A lost frame has used the link all the same, as on the air; a duplicate has not. Each kind of
//! fault has numbers of its own, so that the same frames are lost whether or not some are
//! duplicated as well.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::{Faults, Random};

/// One direction. `T`: what stands for a frame; often its bytes, in simulations less.
#[derive(Clone, Debug)]
pub struct Link<T> {
    faults: Faults,
    random: Streams,
    counts: Counts,
    /// When the last frame accepted will have left the queue.
    busy_until: u64,
    /// Of Gilbert and Elliott's two states.
    bad: bool,
    /// When the last frame arrives that came in order.
    in_order: u64,
    /// The number of the next one: of frames that arrive at the same time the first sent comes
    /// first.
    next: u64,
    under_way: BinaryHeap<Reverse<UnderWay<T>>>,
}

/// A frame at the other end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivery<T> {
    pub frame: T,
    /// When it arrived.
    pub at: u64,
    /// It met congestion: a carrier of real frames sets their CE bits.
    pub marked: bool,
    /// It is not as it was: a number to choose by what has changed ([`Delivery::damage`] for
    /// bytes).
    pub corrupted: Option<u64>,
}

/// What became of frames. Those under way are counted as what they will be; `sent` = the five after
/// it together − `duplicated`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub sent: u64,
    /// Twice, if duplicated.
    pub delivered: u64,
    pub lost: u64,
    pub lost_in_bursts: u64,
    pub partitioned: u64,
    /// Found no room in the queue.
    pub overflowed: u64,
    pub duplicated: u64,
    /// Held back, whether or not another overtook it. Copies included, as in the two below.
    pub held_back: u64,
    pub corrupted: u64,
    pub marked: u64,
    /// Bytes of `delivered`.
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
    /// # Panics
    ///
    /// If the faults make no sense: probabilities beyond 0..=1, a rate of 0, a queue without a
    /// rate.
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

    /// A frame of `bytes` enters. `now` never goes back from one call to the next.
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

    /// From the next frame on other faults. What is under way arrives as it would have.
    ///
    /// # Panics
    ///
    /// As [`Link::new`].
    pub fn change(&mut self, faults: Faults) {
        faults.check();
        self.faults = faults;
    }

    /// What has arrived by `now`, one at a time and in the order of arrival.
    pub fn pop(&mut self, now: u64) -> Option<Delivery<T>> {
        self.next().filter(|at| *at <= now)?;
        self.under_way.pop().map(|Reverse(frame)| frame.delivery)
    }

    /// When the next frame arrives.
    pub fn next(&self) -> Option<u64> {
        self.under_way.peek().map(|Reverse(frame)| frame.delivery.at)
    }

    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// When the frame has left the queue and whether it was marked there; `None` if it found no
    /// room.
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

    /// Draws for every fault, so that none changes what the others do.
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
            self.counts.held_back += 1;
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
    /// Turns one bit of a corrupted frame, from byte `from` on: what stands before it is not the
    /// model's to change.
    pub fn damage(&mut self, from: usize) {
        let Some(choice) = self.corrupted else { return };
        let Some(body) = self.frame.as_mut().get_mut(from..).filter(|body| !body.is_empty()) else { return };
        let bit = choice % (body.len() as u64 * 8);
        body[(bit / 8) as usize] ^= 1 << (bit % 8);
    }
}

impl Counts {
    /// Frames that never arrived.
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
