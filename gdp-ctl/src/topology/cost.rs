//! What it costs to cross a link, as its round-trip time says: steady, because every change may move traffic to another path.

use std::collections::VecDeque;
use std::time::Duration;

/// A hop costs this much besides what its round-trip time adds: as much as 2 ms do. So the differences between cables on one
/// site, which are mostly those of how busy the daemons are, choose no path.
pub const HOP: u32 = 200;

/// A link costs this much at most: that of 1 s.
pub const MOST: u32 = HOP + 100_000;

/// What adds 1 to the cost.
const STEP: Duration = Duration::from_micros(10);

/// The shortest time of so long counts: what radio links add now and then is no property of the path.
const WINDOW: Duration = Duration::from_secs(30);

/// Another cost is stated once it has differed by more than a quarter for so long.
const STEADY: Duration = Duration::from_secs(5);

/// The measured cost of the link to one neighbour.
#[derive(Debug)]
pub struct Meter {
    cost: u32,
    /// When, and what it would have cost then; in both rising from the first to the last.
    recent: VecDeque<(Duration, u32)>,
    differs_since: Option<Duration>,
    /// Nothing but the link's handshake has been measured.
    is_first: bool,
}

impl Meter {
    /// Of a link that has just been made, with the round-trip time that showed; or of one that a daemon before this one made, of
    /// which nothing is known: it costs what a hop does, and what its other end has measured counts.
    pub fn new(now: Duration, rtt: Option<Duration>) -> Self {
        let recent = rtt.map(|rtt| (now, cost_of(rtt))).into_iter().collect();
        Self { cost: rtt.map_or(HOP, cost_of), recent, differs_since: None, is_first: rtt.is_some() }
    }

    /// The first request over a new link was answered within this time. The handshake took longer than what follows it, because both
    /// sides computed; so this counts at once. Whether the link costs something else from now on.
    pub fn answered(&mut self, now: Duration, rtt: Duration) -> bool {
        let cost = cost_of(rtt);
        if !std::mem::take(&mut self.is_first) || cost >= self.cost {
            return false;
        }
        (self.cost, self.recent) = (cost, VecDeque::from([(now, cost)]));
        true
    }

    /// What crossing the link costs.
    pub fn cost(&self) -> u32 {
        self.cost
    }

    /// Takes one more sample of the link's round-trip time; whether the link costs something else from now on.
    pub fn sample(&mut self, now: Duration, rtt: Duration) -> bool {
        let cost = cost_of(rtt);
        while self.recent.back().is_some_and(|(_, larger)| *larger >= cost) {
            self.recent.pop_back();
        }
        self.recent.push_back((now, cost));
        while self.recent.front().is_some_and(|(at, _)| *at + WINDOW <= now) {
            self.recent.pop_front();
        }
        let shortest = self.recent.front().map_or(cost, |(_, cost)| *cost);
        if u64::from(shortest.abs_diff(self.cost)) * 4 <= u64::from(self.cost) {
            self.differs_since = None;
            return false;
        }
        if now - *self.differs_since.get_or_insert(now) < STEADY {
            return false;
        }
        (self.cost, self.differs_since) = (shortest, None);
        true
    }
}

fn cost_of(rtt: Duration) -> u32 {
    let steps = rtt.as_nanos() / STEP.as_nanos();
    u32::try_from(steps).unwrap_or(MOST).saturating_add(HOP).min(MOST)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1000;

    #[test]
    fn a_cost_follows_what_lasts() {
        let mut meter = Meter::new(Duration::ZERO, Some(Duration::from_millis(20)));
        assert_eq!(meter.cost(), 2200);
        let mut link = Link { meter: &mut meter, now: Duration::ZERO };
        assert_eq!(link.run(4, |_| 300), 0, "not at once");
        assert_eq!(link.run(2, |_| 300), 1);
        assert_eq!(link.meter.cost(), 230);
        assert_eq!(link.run(600, |_| 350), 0, "a little more is not worth it");
        assert_eq!(link.run(30, |_| 50 * MS), 0, "nor is what may pass");
        assert_eq!(link.run(10, |_| 50 * MS), 1);
        assert_eq!(link.meter.cost(), 5200);
        assert_eq!(link.run(40, |_| 3600 * 1000 * MS), 1);
        assert_eq!(link.meter.cost(), MOST);
    }

    #[test]
    fn the_first_answer_counts_instead_of_the_handshake() {
        let mut meter = Meter::new(Duration::ZERO, Some(Duration::from_millis(20)));
        assert!(meter.answered(Duration::ZERO, Duration::from_millis(1)));
        assert_eq!(meter.cost(), 300);
        assert!(!meter.answered(Duration::ZERO, Duration::ZERO), "only the first");
        let mut slow = Meter::new(Duration::ZERO, Some(Duration::from_millis(20)));
        assert!(!slow.answered(Duration::ZERO, Duration::from_millis(30)) && slow.cost() == 2200);
        let mut adopted = Meter::new(Duration::ZERO, None);
        assert!(!adopted.answered(Duration::ZERO, Duration::ZERO), "it has a cost that others know");
    }

    #[test]
    fn jitter_of_radio_links_changes_nothing() {
        let mut random = Random(5);
        // Wi-Fi: 2 ms, and up to 100 ms in one sample of five; LTE: 35 to 90 ms all the time, with outages of seconds.
        let mut wifi = |_| 2 * MS + random.below(500) + if random.below(5) == 0 { random.below(100 * MS) } else { 0 };
        let mut meter = Meter::new(Duration::ZERO, Some(Duration::from_millis(2)));
        assert_eq!(Link { meter: &mut meter, now: Duration::ZERO }.run(24 * 3600, &mut wifi), 0);
        let mut random = Random(6);
        let mut lte = |second: u64| match second % 600 {
            0..8 => 2000 * MS,
            _ => 35 * MS + random.below(55 * MS),
        };
        let mut meter = Meter::new(Duration::ZERO, Some(Duration::from_millis(40)));
        assert_eq!(Link { meter: &mut meter, now: Duration::ZERO }.run(24 * 3600, &mut lte), 0);
    }

    struct Link<'a> {
        meter: &'a mut Meter,
        now: Duration,
    }

    impl Link<'_> {
        /// Two samples a second, in µs; how often the cost changed.
        fn run(&mut self, seconds: u64, mut rtt: impl FnMut(u64) -> u64) -> usize {
            let sample = |half: &u64| {
                self.now += Duration::from_millis(500);
                self.meter.sample(self.now, Duration::from_micros(rtt(half / 2)))
            };
            (0..2 * seconds).filter(sample).count()
        }
    }

    struct Random(u64);

    impl Random {
        fn below(&mut self, bound: u64) -> u64 {
            self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (self.0 >> 33) % bound
        }
    }
}
