//! Unit tests of `topology::cost`.

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
    // Wi-Fi: 2 ms, and up to 100 ms in one sample of five; LTE: 35 to 90 ms all the time, with
    // outages of seconds.
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
