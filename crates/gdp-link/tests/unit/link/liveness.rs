//! Unit tests of `link::liveness`, in virtual time.

use super::*;

const MS: Duration = Duration::from_millis(1);
const SECOND: Duration = Duration::from_secs(1);
const FAST: Pace = Pace { interval: MIN_INTERVAL, idle: SECOND, misses: 5 };

/// A link in virtual time, whose caller runs as asked unless [`Self::pause`] is used.
struct World {
    detector: Detector,
    pace: Pace,
    now: Duration,
    sample: Evidence,
    cookie: u64,
    answers: bool,
    has_data: bool,
    steps: usize,
    changes: Vec<(Duration, bool)>,
}

impl World {
    fn new(pace: Pace) -> Self {
        let (detector, sample) = (Detector::default(), Evidence::default());
        let (now, changes) = (Duration::ZERO, Vec::new());
        Self { detector, pace, now, sample, cookie: 0, answers: true, has_data: false, steps: 0, changes }
    }

    /// Runs until `until`, and returns how many echoes were sent.
    fn run(&mut self, until: Duration) -> usize {
        let before = self.steps;
        while self.now < until {
            self.cookie += 1;
            self.sample.data += u64::from(self.has_data);
            let step = self.detector.step(self.now, self.pace, self.sample, self.cookie);
            if self.answers {
                self.sample.answer = self.cookie;
            }
            if step.changed {
                self.changes.push((self.now, self.detector.is_silent()));
            }
            self.steps += 1;
            self.now += step.wait;
        }
        self.steps - before
    }

    /// The caller does not run for this time.
    fn pause(&mut self, time: Duration) {
        self.now += time;
    }
}

#[test]
fn a_link_with_data_that_falls_silent_is_noticed_within_240_ms() {
    for after in 0..MIN_INTERVAL.as_millis() as u32 {
        let mut world = World::new(FAST);
        world.has_data = true;
        world.run(SECOND + after * MS);
        // The last echo was answered just now at the earliest.
        (world.answers, world.has_data) = (false, false);
        let failed = world.now - MIN_INTERVAL;
        world.run(failed + SECOND);
        let [(noticed, true)] = world.changes[..] else { panic!("{:?}", world.changes) };
        assert!(noticed - failed <= 240 * MS, "{:?}", noticed - failed);
    }
}

#[test]
fn a_new_link_has_three_seconds_to_answer() {
    let mut world = World::new(FAST);
    (world.has_data, world.answers) = (true, false);
    world.run(2700 * MS);
    assert_eq!(world.changes, []);
    world.answers = true;
    world.run(4 * SECOND);
    assert_eq!(world.changes, []);
    let mut world = World::new(FAST);
    (world.has_data, world.answers) = (true, false);
    world.run(4 * SECOND);
    assert_eq!(world.changes, [(3 * SECOND, true)]);
}

#[test]
fn data_of_the_last_ten_seconds_counts() {
    let mut world = World::new(FAST);
    world.has_data = true;
    world.run(SECOND);
    world.has_data = false;
    world.run(10 * SECOND);
    world.answers = false;
    let failed = world.now - MIN_INTERVAL;
    world.run(failed + SECOND);
    assert!(world.changes[0].0 - failed <= 240 * MS, "{:?}", world.changes);
}

#[test]
fn an_idle_link_is_asked_once_a_second_and_its_silence_noticed_within_3_s() {
    let mut world = World::new(FAST);
    world.run(60 * SECOND);
    assert_eq!(world.run(160 * SECOND), 100);
    world.answers = false;
    let failed = world.now - SECOND;
    world.run(failed + 3 * SECOND);
    assert!(matches!(world.changes[..], [(_, true)]), "{:?}", world.changes);
    assert!(world.changes[0].0 - failed < 2300 * MS, "{:?}", world.changes);
}

#[test]
fn a_caller_that_did_not_run_blames_nobody() {
    let mut world = World::new(FAST);
    world.has_data = true;
    world.run(SECOND);
    // The answers to the last echoes have arrived, but are not read yet.
    for pause in [100, 300, 1000, 10_000] {
        world.answers = false;
        let until = world.now + 4 * MIN_INTERVAL;
        world.run(until);
        world.pause(pause * MS);
        world.run(world.now + 2 * MIN_INTERVAL);
        world.answers = true;
        world.run(world.now + SECOND);
        assert_eq!(world.changes, [], "{pause} ms");
    }
}

#[test]
fn a_caller_that_is_a_little_late_still_notices() {
    let mut world = World::new(FAST);
    world.has_data = true;
    world.run(SECOND);
    world.answers = false;
    for _ in 0..6 {
        world.run(world.now + MIN_INTERVAL);
        world.pause(MIN_INTERVAL / 2);
    }
    assert!(matches!(world.changes[..], [(_, true)]), "{:?}", world.changes);
}

#[test]
fn losses_between_answers_are_no_silence() {
    for pace in [FAST, Pace::ETHERNET, Pace::UDP] {
        let mut world = World::new(pace);
        world.has_data = true;
        for _ in 0..1000 {
            // One answer for each `misses` echoes.
            for answers in std::iter::repeat_n(false, pace.misses - 1).chain([true]) {
                world.answers = answers;
                world.run(world.now + pace.interval);
            }
        }
        assert_eq!(world.changes, []);
    }
}

#[test]
fn any_frame_of_the_peer_is_a_sign_of_life_where_those_count() {
    let mut world = World::new(FAST);
    (world.has_data, world.answers) = (true, false);
    for _ in 0..100 {
        world.sample.received += 1;
        world.run(world.now + MIN_INTERVAL);
    }
    assert_eq!(world.changes, []);
    world.run(world.now + SECOND);
    assert!(world.detector.is_silent());
}

#[test]
fn a_silent_link_is_asked_slower_and_needs_several_answers_to_be_back() {
    let mut world = World::new(FAST);
    world.answers = false;
    world.run(5 * SECOND);
    assert!(world.detector.is_silent());
    assert_eq!(world.run(15 * SECOND), 50);
    for _ in 0..10 {
        world.answers = true;
        world.run(world.now + 200 * MS);
        world.answers = false;
        world.run(world.now + 200 * MS);
    }
    assert!(world.detector.is_silent(), "one answer here and there");
    world.answers = true;
    let mended = world.now;
    world.run(mended + 2 * SECOND);
    let (back, false) = world.changes[1] else { panic!("{:?}", world.changes) };
    assert!(back - mended <= 800 * MS, "{:?}", back - mended);
}

#[test]
fn an_answer_settles_the_echoes_up_to_its_own() {
    let mut open = Unanswered::default();
    (1..=4).for_each(|cookie| open.add(cookie, 5));
    assert!(open.settle(2));
    open.add(5, 5);
    assert_eq!(open.open, [3, 4, 5]);
    assert!(!open.settle(1), "an older one says nothing new");
    assert!(!open.settle(99), "made up");
    open.add(6, 5);
    assert_eq!(open.open, [3, 4, 5, 6]);
}

#[test]
fn only_the_peer_can_make_echoes_rarer_and_only_within_bounds() {
    assert_eq!(Pace::negotiated(Duration::ZERO).interval, MIN_INTERVAL);
    assert_eq!(Pace::negotiated(100 * MS).interval, 100 * MS);
    assert_eq!(Pace::negotiated(Duration::MAX).interval, SECOND);
    let mut world = World::new(FAST);
    (world.has_data, world.sample.rtt) = (true, 100 * MS);
    world.run(SECOND);
    assert_eq!(world.run(11 * SECOND), 100, "nor faster than a round trip");
}

#[test]
fn without_negotiation_silence_takes_as_long_as_before() {
    for (pace, misses) in [(Pace::ETHERNET, 1000), (Pace::UDP, 3000)] {
        let mut world = World::new(pace);
        world.answers = false;
        world.run(10 * SECOND);
        assert_eq!(world.changes, [(misses * MS, true)]);
    }
}
