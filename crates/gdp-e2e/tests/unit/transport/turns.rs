//! The order of replacement within a single topic, frame by frame.

use super::sealed::Frame;
use super::*;
use gdp_wire::Name;

const READER: Name = Name::from_bytes([9; 32]);
/// Bytes of a message, in ten frames.
const MESSAGE: usize = 10_000;

fn message(sequence: u64) -> Sealed {
    let frame = |index| Frame { first: Position { sequence, index }, end: 1000 * (index as usize + 1) };
    Sealed::without_bytes((0..10).map(frame).collect(), sequence, 0)
}

fn open(options: TopicOptions) -> (Uplink, TopicId) {
    let mut uplink = Uplink::new(0, UplinkOptions { max_payload: 1300, budget: None });
    let topic = uplink.open(0, Name::from_bytes([1; 32]), [1; 16], options);
    uplink.join(0, topic, READER).unwrap();
    (uplink, topic)
}

/// Runs until a time. Returns the number of frames and of [`Output::Room`].
fn run(uplink: &mut Uplink, now: &mut u64, until: u64) -> (usize, usize) {
    let (mut frames, mut rooms) = (0, 0);
    while *now < until {
        match uplink.poll(*now) {
            Some(Output::Send(_)) => frames += 1,
            Some(Output::Room { .. }) => rooms += 1,
            Some(_) => {}
            None => *now += MS / 10,
        }
    }
    (frames, rooms)
}

#[test]
fn what_goes_is_the_last_to_give_way_for_bytes() {
    let history = History { messages: 8, bytes: 2 * MESSAGE };
    let (mut uplink, topic) = open(TopicOptions { history, ..TopicOptions::best_effort() });
    uplink.push(0, topic, message(1)).unwrap();
    assert!(matches!(uplink.poll(0), Some(Output::Send(_))));
    for sequence in 2..20 {
        uplink.push(0, topic, message(sequence)).unwrap();
    }
    run(&mut uplink, &mut 0, 150 * MS);
    let counters = uplink.counters(topic).unwrap();
    assert_eq!((counters.frames, counters.replaced, counters.expired), (20, 17, 0), "the first and the last");
}

#[test]
fn a_publisher_is_told_of_its_turn_once_nothing_waits() {
    let (mut uplink, topic) = open(TopicOptions::best_effort());
    let mut now = 0;
    assert!(uplink.has_turn(topic));
    uplink.push(now, topic, message(1)).unwrap();
    assert!(!uplink.has_turn(topic), "it has not begun");
    let (frames, rooms) = run(&mut uplink, &mut now, 100 * MS);
    assert_eq!((frames, rooms), (10, 1));
    uplink.push(now, topic, message(2)).unwrap();
    assert!(matches!(uplink.poll(now), Some(Output::Send(_))));
    assert!(uplink.has_turn(topic), "the next goes right behind it");
    assert_eq!(run(&mut uplink, &mut now, 200 * MS), (9, 0), "nobody waits");
}

#[test]
fn a_turn_comes_also_when_nobody_reads_any_more() {
    let (mut uplink, topic) = open(TopicOptions::best_effort());
    uplink.push(0, topic, message(1)).unwrap();
    assert!(!uplink.has_turn(topic));
    uplink.leave(0, topic, &READER);
    assert_eq!(run(&mut uplink, &mut 0, MS), (0, 1));
    assert!(uplink.has_turn(topic));
}
