//! The faults of one direction of a link.

/// The faults of one direction of a link. The default is a perfect link: no delay, no limit, no
/// fault. Probabilities apply to each frame and are from 0 to 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Faults {
    /// Rate in bits per second; further frames wait in the queue. `None` means unlimited.
    pub rate: Option<u64>,
    /// Maximum size of the queue of a link with a rate, in bytes, including the frame being sent.
    /// Frames that do not fit are lost. `None` means unlimited.
    pub queue: Option<u64>,
    /// Queue size in bytes above which a new frame is marked as "congestion experienced" (RFC
    /// 3168). `None` means never.
    pub mark_above: Option<u64>,
    /// Delay from one end to the other, in nanoseconds.
    pub delay: u64,
    /// Maximum additional delay in nanoseconds, evenly distributed. Like a queue it preserves the
    /// order; only [`Self::reorder`] changes that.
    pub jitter: u64,
    /// Probability that a frame is lost.
    pub loss: f64,
    /// Loss of many frames in a row.
    pub burst: Option<Burst>,
    pub reorder: Option<Reorder>,
    /// Probability that a frame arrives twice.
    pub duplicate: f64,
    /// Probability that a frame arrives with one bit changed.
    pub corrupt: f64,
    /// Intervals in nanoseconds, each without its end, in which every frame is lost.
    pub partitions: Vec<(u64, u64)>,
}

/// The Gilbert–Elliott model: a link is in a good state or in a bad state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Burst {
    /// Probability at each frame of a change from good to bad.
    pub enter: f64,
    /// Probability at each frame of a change from bad to good. A bad state lasts `1 / leave` frames
    /// on average.
    pub leave: f64,
    /// Probability that a frame is lost in the bad state.
    pub loss: f64,
}

/// Delays some frames, so that later ones overtake them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reorder {
    pub probability: f64,
    /// Maximum additional delay in nanoseconds, evenly distributed.
    pub by: u64,
}

impl Faults {
    /// Returns faults that only delay frames.
    pub fn delay(nanoseconds: u64) -> Self {
        Self { delay: nanoseconds, ..Self::default() }
    }

    /// Panics on values that make no sense, which indicate a mistake in a test.
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
