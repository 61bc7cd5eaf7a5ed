//! Tests of two ends of a link whose frames and announcements are delayed, lost or duplicated.

use gdp_wire::hop;
use std::collections::VecDeque;

use gdp_wire::{Counter, FrameType, Header, LinkRole, Name, forward, replay};
use serde_json::{Value, json};

use super::*;

const SCHEDULE: RekeySchedule =
    RekeySchedule { interval: Duration::from_secs(100), frames: 1000, overlap: Duration::from_secs(2) };

#[test]
fn both_ends_move_on_and_lose_nothing_though_frames_overtake_each_other() {
    let mut pair = Pair::new();
    let mut under_way = VecDeque::new();
    let mut random = random(1);
    for second in 0..1200 {
        for _ in 0..5 {
            for side in [0, 1] {
                under_way.push_back((pair.time, 1 - side, pair.send(side)));
            }
        }
        // A frame is in flight for less than the overlap, and frames may be reordered.
        while let Some((sent, ..)) = under_way.front() {
            let at = random(under_way.len().min(8) as u64) as usize;
            if pair.time - *sent < SCHEDULE.overlap && random(3) > 0 {
                break;
            }
            let (_, side, header) = under_way.remove(at).expect("fewer than there are");
            assert_eq!(pair.take(side, &header), Ok(FrameType::Data), "at {second} s");
        }
        pair.advance(Duration::from_secs(1), |_, _| true);
    }
    assert!(pair.generations().into_iter().all(|(rx, tx)| rx >= 11 && tx >= 11), "{:?}", pair.generations());
}

#[test]
fn a_sender_does_not_move_twice_without_an_answer_and_its_frames_are_taken_meanwhile() {
    let mut pair = Pair::new();
    for (lost, by, is_answer) in [("announcements", 0, false), ("answers", 1, true)] {
        let start = pair.sides[0].ratchet.generations().1;
        for _ in 0..500 {
            let header = pair.send(0);
            assert_eq!(pair.take(1, &header), Ok(FrameType::Data), "{lost}");
            pair.advance(Duration::from_secs(1), |side, answers| (side, answers) != (by, is_answer));
        }
        assert_eq!(pair.sides[0].ratchet.generations().1, start + 1, "lost: {lost}");
        // Without further loss, the ratchet continues.
        (0..400).for_each(|_| pair.advance(Duration::from_secs(1), |_, _| true));
        assert!(pair.sides[0].ratchet.generations().1 >= start + 3);
        let header = pair.send(0);
        assert_eq!(pair.take(1, &header), Ok(FrameType::Data));
    }
}

#[test]
fn a_recorded_frame_is_refused_under_every_key_to_come() {
    let mut pair = Pair::new();
    let (taken, held_back) = (pair.send(0), pair.send(0));
    assert_eq!(pair.take(1, &taken), Ok(FrameType::Data));
    assert_eq!(pair.take(1, &taken), Err(Counter::Replayed), "while its key is in use");
    let mut refused_as_forged = 0;
    for _ in 0..1000 {
        pair.advance(Duration::from_secs(1), |_, _| true);
        let refused = pair.take(1, &taken);
        assert!(matches!(refused, Err(Counter::Replayed | Counter::BadTag)), "{refused:?}");
        refused_as_forged += u32::from(refused == Err(Counter::BadTag));
        assert_eq!(refused == Err(Counter::BadTag), pair.sides[1].ratchet.rx.held_from() > 0, "its key is gone");
    }
    assert!(refused_as_forged > 800);
    assert_eq!(pair.take(1, &held_back), Err(Counter::BadTag), "one that never arrived, too");
}

#[test]
fn many_frames_end_a_key_before_its_time() {
    let mut pair = Pair::new();
    for _ in 0..SCHEDULE.frames - 1 {
        pair.send(0);
    }
    pair.advance(Duration::from_secs(1), |_, _| true);
    assert_eq!(pair.generations(), [(0, 0); 2]);
    pair.send(0);
    pair.advance(Duration::from_secs(1), |_, _| true);
    assert_eq!(pair.generations(), [(0, 1), (1, 0)]);
    // The count continues, and the next key may tag as many frames.
    for _ in 0..20 {
        pair.advance(Duration::from_secs(1), |_, _| true);
    }
    assert_eq!(pair.generations(), [(0, 1), (1, 0)]);
}

#[test]
fn an_announcement_is_known_awaited_or_impossible() {
    let mut ratchet = ratchet(0);
    let start = Instant::now();
    let keys = ratchet.keys();
    assert_eq!(ratchet.announced(0, start), AnnouncementOutcome::Known);
    assert_eq!(ratchet.announced(2, start), AnnouncementOutcome::Impossible, "this side has not confirmed 1");
    assert_eq!(ratchet.announced(u64::MAX, start), AnnouncementOutcome::Impossible);
    assert_eq!(ratchet.announced(1, start), AnnouncementOutcome::Later);
    assert_eq!(ratchet.announced(2, start), AnnouncementOutcome::Impossible);
    let middle = start + SCHEDULE.overlap / 2;
    assert_eq!(ratchet.announced(1, middle), AnnouncementOutcome::Later, "asked again");
    assert_eq!(ratchet.wake_at(middle), start + SCHEDULE.overlap, "which does not put it off");
    assert_eq!(ratchet.poll(middle, 0), Ok(None));
    assert!(ratchet.keys() == keys, "the old key is still held");
    assert_eq!(ratchet.poll(start + SCHEDULE.overlap, 0), Ok(Some(RekeyStep::Confirm)));
    assert_eq!(ratchet.keys().rx_keys[1], keys.rx_keys[1]);
    assert_ne!(ratchet.keys().rx_keys[0], keys.rx_keys[0]);
    assert_eq!(ratchet.announced(1, start + SCHEDULE.overlap), AnnouncementOutcome::Known, "its answer was lost");
    assert_eq!(ratchet.announced(0, start + SCHEDULE.overlap), AnnouncementOutcome::Known, "one that came late");
}

/// Each change writes the tables twice. Neither write touches the key that currently tags frames.
#[test]
fn the_phase_never_points_to_a_key_that_is_being_replaced() {
    let (mut ratchet, start) = (ratchet(0), Instant::now());
    for round in 1..10 {
        let before = ratchet.keys();
        assert_eq!(ratchet.poll(start + SCHEDULE.interval * round, 0), Ok(Some(RekeyStep::Announce(round.into()))));
        let moved = ratchet.keys();
        assert_eq!((moved.tx_keys, moved.tx_phase), (before.tx_keys, 1 - before.tx_phase), "first only the phase");
        assert_eq!(ratchet.answered(true, start + SCHEDULE.interval * round), Ok(true));
        let after = ratchet.keys();
        let in_use = after.tx_phase as usize;
        assert_eq!((after.tx_phase, after.tx_keys[in_use]), (moved.tx_phase, moved.tx_keys[in_use]));
        assert_ne!(after.tx_keys[1 - in_use], moved.tx_keys[1 - in_use], "then only the other key");
        assert_eq!(ratchet.answered(true, start), Ok(false), "an answer to nothing");
    }
}

#[test]
fn nothing_prints_a_key() {
    let keys = LinkKeys { rx_keys: [[0x4242; 2]; 2], tx_keys: [[0x5353; 2]; 2], tx_phase: 1 };
    let text = format!("{keys:?} {keys:#x?}");
    for secret in ["4242", "5353", "16962", "21331"] {
        assert!(!text.contains(secret), "{text}");
    }
}

/// `docs/vectors/link_keys.json`; `GDP_WRITE_VECTORS=1 cargo test -p gdp-link vectors` rewrites the
/// file.
#[test]
fn vectors_of_link_keys() {
    let chains: Vec<Value> = [[0; 32], std::array::from_fn(|i| i as u8)].into_iter().map(chain).collect();
    crate::vectors::check(
        "link_keys.json",
        &json!({
            "about": "per direction of a link: key n = first 16 bytes of HKDF-SHA256(IKM = secret n, no salt, info = \"gdp/link-key/1\"); secret n+1 = HKDF-SHA256(IKM = secret n, no salt, info = \"gdp/link-secret/1\"), 32 bytes; secret 0 is from the TLS exporter",
            "vectors": chains,
        }),
    );
}

/// Derives the first generations with [`TrafficSecret`], and the secrets with both back ends.
fn chain(secret: [u8; 32]) -> Value {
    let mut secrets = TrafficSecret::new(Zeroizing::new(secret)).unwrap();
    let mut secret = Zeroizing::new(secret);
    let generations = (0..4u64).map(|generation| {
        if generation > 1 {
            secrets.replace(generation).unwrap();
        }
        let [low, high] = secrets.keys[(generation % 2) as usize];
        let this = json!({
            "generation": generation,
            "key_phase": generation % 2,
            "secret": hex::encode(*secret),
            "key": hex::encode([low.to_le_bytes(), high.to_le_bytes()].concat()),
        });
        secret = crypto::hkdf_sha256(&[], &*secret, &[SECRET_CONTEXT]).unwrap();
        this
    });
    json!({"generations": generations.collect::<Vec<_>>()})
}

/// Sides 0 and 1. Announcements and answers take no time.
struct Pair {
    sides: [Side; 2],
    time: Duration,
    start: Instant,
}

struct Side {
    ratchet: Ratchet,
    /// The entry in this side's data plane.
    entry: LinkEntry,
    window: Box<replay::Window>,
    sent: u64,
    /// Whether an announcement from the peer awaits its answer.
    waiting: bool,
}

impl Pair {
    fn new() -> Self {
        let side = |which: u8| {
            let ratchet = ratchet(which);
            let mut entry = LinkEntry { id: 7, peer_id: 7, role: LinkRole::Switch as u32, ..LinkEntry::default() };
            ratchet.keys().put(&mut entry);
            Side { ratchet, entry, window: Box::new(replay::empty()), sent: 0, waiting: false }
        };
        Self { sides: [side(0), side(1)], time: Duration::ZERO, start: Instant::now() }
    }

    fn generations(&self) -> [(u64, u64); 2] {
        [0, 1].map(|side: usize| self.sides[side].ratchet.generations())
    }

    fn send(&mut self, side: usize) -> Header {
        let side = &mut self.sides[side];
        side.sent += 1;
        let mut header = Header::data(Name::from_bytes([1; 32]), Name::from_bytes([2; 32]), 0);
        hop::stamp(&mut header, &side.entry, side.sent);
        header
    }

    fn take(&self, side: usize, header: &Header) -> Result<FrameType, Counter> {
        forward::accept(header, Header::LEN, &self.sides[side].entry, &*self.sides[side].window)
    }

    /// Advances the time. `arrives(from, is_answer)` decides whether a message from this side
    /// arrives.
    fn advance(&mut self, time: Duration, arrives: impl Fn(usize, bool) -> bool) {
        self.time += time;
        let now = self.start + self.time;
        for from in [0, 1] {
            let to = 1 - from;
            while let Some(step) = self.sides[from].ratchet.poll(now, self.sides[from].sent).unwrap() {
                self.put(from);
                match step {
                    RekeyStep::Announce(generation) if arrives(from, false) => {
                        match self.sides[to].ratchet.announced(generation, now) {
                            AnnouncementOutcome::Later => self.sides[to].waiting = true,
                            AnnouncementOutcome::Known => self.answer(from, arrives(to, true), now),
                            AnnouncementOutcome::Impossible => panic!("{:?}", self.generations()),
                        }
                    }
                    RekeyStep::Announce(_) => self.answer(from, false, now),
                    RekeyStep::Confirm => {
                        assert!(std::mem::take(&mut self.sides[from].waiting));
                        self.answer(to, arrives(from, true), now);
                    }
                }
            }
        }
    }

    fn answer(&mut self, side: usize, confirmed: bool, now: Instant) {
        self.sides[side].ratchet.answered(confirmed, now).unwrap();
        self.put(side);
    }

    fn put(&mut self, side: usize) {
        let Side { ratchet, entry, .. } = &mut self.sides[side];
        ratchet.keys().put(entry);
    }
}

impl Rx {
    /// Returns the older of the two stored generations.
    fn held_from(&self) -> u64 {
        if self.retires.is_some() { self.generation - 1 } else { self.generation }
    }
}

/// Creates the ratchet of side 0 or 1.
fn ratchet(side: u8) -> Ratchet {
    let secret = |which| Zeroizing::new([which; 32]);
    Ratchet::new(secret(1 - side), secret(side), SCHEDULE, Instant::now()).unwrap()
}

/// Returns a generator of bounded random numbers, the same in every run.
fn random(mut state: u64) -> impl FnMut(u64) -> u64 {
    move |bound| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) % bound
    }
}
