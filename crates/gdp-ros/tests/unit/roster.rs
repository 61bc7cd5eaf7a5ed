#[path = "../../../gdp-core/tests/unit/published_schema.rs"]
mod schema;

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp_e2e::seal::Message;
use gdp_wire::Name;

use super::outgoing::Announcement;
use super::*;
use crate::call;

const RELIABLE: Offer = Offer::DEFAULT;
/// The full name of the publishers' node.
const NODE: &str = "/robot7/driver";

const LATCHED: Offer = Offer { transient_local: true, depth: 1, ..RELIABLE };

fn kind() -> Kind {
    Kind { dialect: Dialect::Ros2, name: "std_msgs/msg/String".into(), hash: vec![7; 32] }
}

fn name(i: u8) -> Name {
    Name::from_bytes([i; 32])
}

fn message(writer: u8, sequence: u64, origin: &[u8], body: impl Into<Bytes>) -> Message {
    Message {
        name: name(0),
        writer: name(writer),
        session: [writer; 16],
        sequence,
        timestamp_ns: 0,
        encoding: ROSTER,
        in_reply_to: None,
        origin: Bytes::copy_from_slice(origin),
        latched: None,
        service: None,
        body: body.into(),
    }
}

fn body(announcement: Option<Announcement>) -> Vec<u8> {
    match announcement {
        Some(Announcement::Whole(body) | Announcement::Brief(body)) => body,
        None => panic!("nothing is sent"),
    }
}

fn joined(number: u32, offers: Offer, definition: Option<&str>) -> Change {
    let definition = definition.map(Arc::from);
    Change::Joined { writer: name(1), number, kind: kind(), definition, node: NODE.into(), offers }
}

#[test]
fn lists_and_descriptions_have_the_published_schema() {
    let mut out = Outgoing::new(kind(), Some("string data".into()));
    out.joined('a', NODE, RELIABLE);
    out.joined('b', "", LATCHED);
    let list = body(out.poll(Instant::now()).unwrap());
    schema::check("publisher-list", &list).unwrap();
    schema::check("publisher-list", &brief_of(&list)).unwrap();
    let ros1 = Kind { dialect: Dialect::Ros1, name: "std_msgs/String".into(), hash: vec![] };
    schema::check("publisher-list", &body(Outgoing::<char>::new(ros1, None).poll(Instant::now()).unwrap())).unwrap();
    let definitions = call::Definitions { request: "int64 a".into(), response: String::new() };
    for definitions in [None, Some(definitions)] {
        let described = call::Description { kind: kind(), node: NODE.into(), definitions };
        let reply = call::Reply::Description(call::Epoch(7), described).to_bytes().unwrap();
        schema::check("description", &reply[10..]).unwrap();
    }
    let long = Kind { hash: vec![0; 33], ..kind() };
    let list = body(Outgoing::<char>::new(long, None).poll(Instant::now()).unwrap());
    schema::check("publisher-list", &list).unwrap_err();
}

#[test]
fn publishers_come_and_go_at_the_other_end() {
    let now = Instant::now();
    let (mut out, mut into) = (Outgoing::new(kind(), Some("string data".into())), Incoming::default());
    out.joined('a', NODE, RELIABLE);
    out.joined('b', NODE, LATCHED);
    let first = body(out.poll(now).unwrap());
    let (changes, _) = into.roster(now, &message(1, 1, b"", first)).unwrap();
    let definition = Some("string data");
    assert_eq!(changes, [joined(0, RELIABLE, definition), joined(1, LATCHED, definition)]);

    assert_eq!(out.poll(now).unwrap(), None);
    let Some(Announcement::Brief(brief)) = out.poll(now + REFRESH).unwrap() else { panic!("nothing has changed") };
    assert!(brief.len() < 450, "{}", brief.len());
    assert_eq!(into.roster(now, &message(1, 2, b"", brief)), Ok((vec![], vec![])), "the definition is known");

    let is_whole = |announcement| matches!(announcement, Some(Announcement::Whole(_)));
    let whole: Vec<u32> = (2..24).filter(|i| is_whole(out.poll(now + *i * REFRESH).unwrap())).collect();
    assert_eq!(whole, [11, 22], "it may have been lost");

    assert_eq!(out.left(&'a'), Some(0));
    out.joined('b', NODE, RELIABLE);
    out.joined('c', NODE, RELIABLE);
    let changed = body(out.poll(now).unwrap());
    let (changes, _) = into.roster(now, &message(1, 4, b"", changed.clone())).unwrap();
    let left = |number| Change::Left { writer: name(1), number };
    assert_eq!(changes, [left(0), joined(1, RELIABLE, definition), joined(2, RELIABLE, definition)]);
    let (late, _) = into.roster(now, &message(1, 3, b"", brief_of(&changed))).unwrap();
    assert_eq!(late, [], "an earlier one changes nothing");

    let silent = |number| Change::Silent { writer: name(1), number };
    assert_eq!(into.poll(now + LEASE / 2), []);
    assert_eq!(into.poll(now + LEASE), [RosterEvent::Changes(vec![silent(1), silent(2)])]);
    assert_eq!(into.poll(now + 2 * LEASE), [], "once");
    let back = body(out.poll(now + LEASE).unwrap());
    let (changes, _) = into.roster(now + LEASE, &message(1, 9, b"", back)).unwrap();
    assert_eq!(changes, [joined(1, RELIABLE, definition), joined(2, RELIABLE, definition)], "its definition is known");
    assert_eq!(into.clear(), [left(1), left(2)]);
}

#[test]
fn a_roster_carries_the_liveliness_and_the_node_of_a_publisher() {
    let now = Instant::now();
    let (mut out, mut into) = (Outgoing::new(kind(), None), Incoming::default());
    out.joined('a', NODE, RELIABLE);
    out.joined('b', NODE, RELIABLE);
    let mut sequence = 0;
    let mut told = |out: &mut Outgoing<char>, into: &mut Incoming| {
        sequence += 1;
        let roster = body(out.poll(now).unwrap());
        into.roster(now, &message(1, sequence, b"", roster)).unwrap().0
    };
    assert_eq!(told(&mut out, &mut into), [joined(0, RELIABLE, None), joined(1, RELIABLE, None)]);
    out.set_alive(&'a', false);
    assert_eq!(told(&mut out, &mut into), [Change::Silent { writer: name(1), number: 0 }]);
    // What waits for a publisher that is not alive gets no younger by further lists.
    assert_eq!(into.message(now, message(1, 9, &origin(0), "waits")), None);
    out.again();
    assert_eq!(told(&mut out, &mut into), []);
    assert_eq!(into.poll(now + LEASE).last(), Some(&RosterEvent::Unannounced(1)));
    out.set_alive(&'a', true);
    // The other one was silent for as long.
    assert_eq!(told(&mut out, &mut into), [joined(0, RELIABLE, None), joined(1, RELIABLE, None)]);
    out.set_alive(&'a', true);
    assert_eq!(out.poll(now), Ok(None), "nothing has changed");

    out.joined('b', "/other", RELIABLE);
    let Change::Joined { writer, number, kind, definition, offers, .. } = joined(1, RELIABLE, None) else { panic!() };
    let moved = Change::Joined { writer, number, kind, definition, node: "/other".into(), offers };
    assert_eq!(told(&mut out, &mut into), [moved]);
}

/// One that lists nobody.
fn brief_of(roster: &[u8]) -> Vec<u8> {
    let roster = Roster::from_bytes(roster).unwrap();
    Roster { writers: vec![], definition: None, ..roster }.to_bytes().unwrap()
}

#[test]
fn who_promises_more_is_missed_sooner_and_spoken_of_more_often() {
    let now = Instant::now();
    let (mut out, mut into) = (Outgoing::new(kind(), None), Incoming::default());
    let lively = Offer { liveliness_ns: 2_000_000_000, deadline_ns: 9_000_000_000, ..RELIABLE };
    out.joined(0, NODE, RELIABLE);
    assert_eq!((RELIABLE.lease(), lively.lease()), (LEASE, Duration::from_secs(2)));
    assert_eq!(Offer { deadline_ns: 1, ..RELIABLE }.lease(), MIN_LEASE);
    out.joined(1, NODE, lively);
    let roster = body(out.poll(now).unwrap());
    into.roster(now, &message(1, 1, b"", roster)).unwrap();
    // At the next common tick of that period.
    assert!(out.due().is_some_and(|due| due > now && due <= now + Duration::from_millis(500)));
    let at = |ms| now + Duration::from_millis(ms);
    // A message shows that its proxy is there as well as a roster does.
    into.message(at(1500), message(1, 2, &origin(0), "x"));
    assert_eq!(into.poll(at(3499)), []);
    let missed = Change::Silent { writer: name(1), number: 1 };
    assert_eq!(into.poll(at(3500)), [RosterEvent::Changes(vec![missed])]);
    let again = body(out.poll(at(3600)).unwrap());
    let (changes, _) = into.roster(at(3600), &message(1, 3, b"", again)).unwrap();
    assert_eq!(changes, [joined(1, lively, None)], "the other was never missed");
    let (changes, _) = into.roster(at(3700), &message(1, 4, b"", out.farewell().unwrap())).unwrap();
    assert_eq!(changes, [0, 1].map(|number| Change::Left { writer: name(1), number }));
}

#[test]
fn messages_wait_for_the_roster_that_tells_of_their_publisher() {
    let now = Instant::now();
    let (mut out, mut into) = (Outgoing::new(kind(), None), Incoming::default());
    assert!(matches!(into.message(now, message(1, 1, b"", "plain")), Some(RosterEvent::Plain(_))));
    for i in 0..3u32 {
        assert_eq!(into.message(now, message(1, 2 + u64::from(i), &origin(i), "held")), None);
    }
    assert_eq!(into.message(now, message(2, 1, &origin(0), "another's")), None);
    out.joined(0, NODE, RELIABLE);
    out.joined(1, NODE, RELIABLE);
    let (_, released) = into.roster(now, &message(1, 5, b"", body(out.poll(now).unwrap()))).unwrap();
    assert_eq!(released.iter().map(|message| message.sequence).collect::<Vec<_>>(), [2, 3]);
    assert!(matches!(into.message(now, message(1, 6, &origin(1), "x")), Some(RosterEvent::Message(1, _))));
    // A writer that began anew numbers its publishers anew.
    let mut anew = message(1, 1, &origin(1), "x");
    anew.session = [9; 16];
    assert_eq!(into.message(now, anew), None);
    let unannounced = RosterEvent::Unannounced(3);
    assert!(into.poll(now + LEASE).contains(&unannounced), "two of publishers that were never listed, and this one");
}

#[test]
fn a_new_session_has_other_publishers() {
    let now = Instant::now();
    let (mut out, mut into) = (Outgoing::new(kind(), None), Incoming::default());
    out.joined(0, NODE, RELIABLE);
    let roster = body(out.poll(now).unwrap());
    into.roster(now, &message(1, 9, b"", roster.clone())).unwrap();
    let mut anew = message(1, 1, b"", roster);
    anew.session = [9; 16];
    let (changes, _) = into.roster(now, &anew).unwrap();
    assert_eq!(changes, [Change::Left { writer: name(1), number: 0 }, joined(0, RELIABLE, None)]);
}

#[test]
fn what_waits_is_bounded() {
    let (mut into, now) = (Incoming::default(), Instant::now());
    let large = Bytes::from(vec![0; 20 << 20]);
    assert_eq!(into.message(now, message(1, 1, &origin(0), large.clone())), None);
    assert_eq!(into.message(now, message(1, 2, &origin(0), large)), Some(RosterEvent::Unannounced(1)));
    let mut crowded = 0;
    for i in 0..3000 {
        if let Some(RosterEvent::Unannounced(gone)) = into.message(now, message(1, 3 + i, &origin(0), "")) {
            crowded += gone;
        }
    }
    assert_eq!(crowded, 3001 - 1024);
}

#[test]
fn what_is_no_roster_is_refused_and_named() {
    let good = Roster { version: VERSION, kind: kind(), definition: None, writers: vec![] };
    let refused = |roster: &Roster| Roster::from_bytes(&roster.to_bytes().unwrap()).unwrap_err().to_string();
    assert!(Roster::from_bytes(b"").is_err() && Roster::from_bytes(&[0xff; 9]).is_err());
    assert!(Roster::from_bytes(&good.to_bytes().unwrap()).is_ok());
    assert!(refused(&Roster { version: 1, ..good.clone() }).contains("version 1"));
    let long = Kind { name: "x".repeat(257), ..kind() };
    assert!(refused(&Roster { kind: long, ..good.clone() }).contains("name: 257 where at most 256"));
    let definition = Some("x".repeat(MAX_DEFINITION + 1));
    assert!(refused(&Roster { definition, ..good.clone() }).contains("definition"));
    let writer = Writer { number: 1, node: NODE.into(), alive: true, offers: RELIABLE };
    let unnamed = Writer { node: "x".repeat(256), ..writer.clone() };
    assert!(refused(&Roster { writers: vec![unnamed], ..good.clone() }).contains("node's name: 256"));
    assert!(refused(&Roster { writers: vec![writer.clone(), writer.clone()], ..good.clone() }).contains("order"));
    let many = (0..=MAX_WRITERS as u32).map(|number| Writer { number, ..writer.clone() }).collect();
    assert!(refused(&Roster { writers: many, ..good }).contains("publishers: 513"));
}

#[test]
fn of_too_many_publishers_the_last_have_no_number() {
    let mut out = Outgoing::new(kind(), None);
    (0..MAX_WRITERS + 5).for_each(|key| out.joined(key, NODE, RELIABLE));
    assert_eq!((out.number(&0), out.number(&MAX_WRITERS)), (Some(0), None));
    out.left(&0);
    out.joined(MAX_WRITERS, NODE, RELIABLE);
    assert_eq!(out.number(&MAX_WRITERS), Some(MAX_WRITERS as u32), "never one that was another's");
    let roster = body(out.poll(Instant::now()).unwrap());
    assert_eq!(Roster::from_bytes(&roster).unwrap().writers.len(), MAX_WRITERS);
}
