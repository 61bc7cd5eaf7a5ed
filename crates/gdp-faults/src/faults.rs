//! What is wrong with one direction of a link.

/// The default is a perfect link: no delay, no limit, no fault. Probabilities are of each frame, 0
/// to 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults {
    /// Bits per second; frames beyond wait in the queue. `None`: as many as come.
    pub rate: Option<u64>,
    /// Bytes that may wait or be under way onto a link with a rate; a frame that finds no room is
    /// lost. `None`: any number.
    pub queue: Option<u64>,
    /// A frame that finds more bytes than this before it is marked (congestion experienced, RFC
    /// 3168), instead of nothing.
    pub mark_above: Option<u64>,
    /// Nanoseconds from one end to the other.
    pub delay: u64,
    /// Up to as many nanoseconds more, evenly. As in a queue it keeps the order; what changes that
    /// is [`Self::reorder`].
    pub jitter: u64,
    /// Loss of single frames.
    pub loss: f64,
    /// Loss of many in a row.
    pub burst: Option<Burst>,
    pub reorder: Option<Reorder>,
    /// A frame arrives twice.
    pub duplicate: f64,
    /// A bit of a frame is another when it arrives.
    pub corrupt: f64,
    /// From the first time on until before the second nothing gets through, and no frame is told.
    pub partitions: Vec<(u64, u64)>,
}

/// Gilbert and Elliott's model: a link is in a good state or in a bad one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Burst {
    /// From good to bad, at each frame.
    pub enter: f64,
    /// From bad to good, at each frame: bad times last `1 / leave` frames in the mean.
    pub leave: f64,
    /// Of each frame in a bad time.
    pub loss: f64,
}

/// Some frames take longer than others, and those behind overtake them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reorder {
    pub probability: f64,
    /// Up to as many nanoseconds longer, evenly.
    pub by: u64,
}

impl Faults {
    /// Nothing but the time it takes.
    pub fn delay(nanoseconds: u64) -> Self {
        Self { delay: nanoseconds, ..Self::default() }
    }

    /// What a mistake in a test would make meaningless.
    pub(crate) fn check(&self) {
        let mut probabilities = vec![self.loss, self.duplicate, self.corrupt];
        probabilities.extend(self.burst.iter().flat_map(|burst| [burst.enter, burst.leave, burst.loss]));
        probabilities.extend(self.reorder.iter().map(|reorder| reorder.probability));
        assert!(probabilities.iter().all(|p| (0.0..=1.0).contains(p)), "a probability is not in 0..=1: {self:?}");
        assert!(self.rate != Some(0), "a link of rate 0 is a partition: {self:?}");
        let queue = self.queue.is_some() || self.mark_above.is_some();
        assert!(!queue || self.rate.is_some(), "frames wait only where there is a rate: {self:?}");
    }

    pub(crate) fn is_partitioned(&self, at: u64) -> bool {
        self.partitions.iter().any(|(from, to)| (*from..*to).contains(&at))
    }
}
