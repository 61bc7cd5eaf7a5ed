//! Unit tests of `node::subscription_receiver`.

use super::*;
use gdp_core::identity::SigningKey;
use gdp_core::keys::EpochKey;
use gdp_e2e::seal::{Encoding, Segments};

const NAME: Name = Name::from_bytes([1; 32]);

/// The RIB may announce a writer twice. Frames that the writer sent before the second Hello may
/// have been lost.
#[test]
fn what_was_lost_between_two_greetings_is_asked_for() {
    let (queue, _messages) = mpsc::channel(4);
    let mut intake = SubscriptionReceiver::new(NAME, SubscribeOptions::reliable(), queue, Arc::default());
    let (key, counters, writer) =
        (SigningKey::from_secret_bytes(&[1; 32]).unwrap(), Counters::default(), Name::from_bytes([2; 32]));
    let session = [3; 16];
    let mut asked = Vec::new();
    for (now, sequence) in [(0, 1), (1_000_000_000, 3)] {
        intake.change(now, Change::Authorise { writer, key: key.verify_key() });
        intake.poll(now, &counters, |_, said| match said {
            Feedback::Hello { challenge, .. } => asked.push(challenge),
            other => panic!("{other:?}"),
        });
        let challenge = *asked.last().unwrap();
        assert!(intake.hear(
            now,
            &writer,
            &Feedback::Welcome { name: NAME, challenge, session, sequence, history: 1024 }
        ));
    }
    assert_ne!(asked[0], asked[1]);
    let (mut missing, mut now) = (Vec::new(), 1_000_000_000);
    while missing.is_empty() && now < 3_000_000_000 {
        now += 10_000_000;
        intake.poll(now, &counters, |_, said| {
            if let Feedback::Nack { missing: ranges, .. } = said {
                missing.extend(ranges.iter().map(|range| range.sequence));
            }
        });
    }
    assert_eq!(missing, [1, 2]);
}

/// Ten thousand writers join, each sends a message and the start of another, and leave.
#[test]
fn nothing_is_left_of_writers_that_came_and_went() {
    let (queue, mut messages) = mpsc::channel(4);
    let mut intake = SubscriptionReceiver::new(NAME, SubscribeOptions::reliable(), queue, Arc::default());
    let (key, counters) = (SigningKey::from_secret_bytes(&[1; 32]).unwrap(), Counters::default());
    let mut segments = Segments::new();
    for n in 0..10_000_u64 {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&n.to_be_bytes());
        let writer = Name::from_bytes(bytes);
        let mut seals = gdp_e2e::seal::Writer::new(NAME, writer, key.clone(), Backend::selected()).unwrap();
        seals.set_epoch(1, &EpochKey::from_bytes([2; 32])).unwrap();
        let now = Timestamps { steady_ns: n * 1_000_000, unix_ns: 1_000_000_000 };
        intake.change(now.steady_ns, Change::Authorise { writer, key: key.verify_key() });
        let opened = Opened { epoch: 1, key: EpochKey::from_bytes([2; 32]), dropped: None };
        intake.change(now.steady_ns, Change::Key { writer, opened });
        let mut challenge = None;
        intake.poll(now.steady_ns, &counters, |_, said| match said {
            Feedback::Hello { challenge: asked, .. } => challenge = Some(asked),
            other => panic!("{other:?}"),
        });
        let welcome = Feedback::Welcome {
            name: NAME,
            challenge: challenge.unwrap(),
            session: seals.session(),
            sequence: 1,
            history: 1024,
        };
        assert!(intake.hear(now.steady_ns, &writer, &welcome));
        for body in [&b"whole"[..], &[7; 3000]] {
            seals.seal(now.unix_ns, Encoding::Bytes, body, 1000, &mut segments).unwrap();
            intake.push(now, writer, segments.iter().next().unwrap(), false, &counters);
        }
        intake.poll(now.steady_ns, &counters, |_, _| {});
        assert_eq!(&messages.try_recv().unwrap().body[..], b"whole");
        assert!(intake.reader.memory() > 0, "of the message that is not complete");
        intake.change(now.steady_ns, Change::Revoke { writer });
    }
    assert_eq!((intake.writers.len(), intake.reader.writers().count(), intake.reader.memory()), (0, 0, 0));
    assert!(
        intake.writers.capacity() < 64 && intake.stalled.capacity() < 64 && intake.received.segments.capacity() < 64
    );
    assert_eq!(intake.next_wake(), None);
}

/// An attacker on the path of one writer gives its frames the name of another, whose frames take
/// another path, and marks them. The other must not slow down.
#[test]
fn a_mark_counts_for_who_sealed_the_frame_only() {
    let (queue, _messages) = mpsc::channel(4);
    let mut intake = SubscriptionReceiver::new(NAME, SubscribeOptions::reliable(), queue, Arc::default());
    let (key, counters) = (SigningKey::from_secret_bytes(&[1; 32]).unwrap(), Counters::default());
    let now = Timestamps { steady_ns: 1_000_000, unix_ns: 1_000_000_000 };
    let mut seals = [2, 3].map(|n| {
        let (writer, secret) = (Name::from_bytes([n; 32]), EpochKey::from_bytes([n; 32]));
        let mut seals = gdp_e2e::seal::Writer::new(NAME, writer, key.clone(), Backend::selected()).unwrap();
        seals.set_epoch(1, &secret).unwrap();
        intake.change(now.steady_ns, Change::Authorise { writer, key: key.verify_key() });
        intake.change(now.steady_ns, Change::Key { writer, opened: Opened { epoch: 1, key: secret, dropped: None } });
        let mut asked = None;
        intake.poll(now.steady_ns, &counters, |_, said| match said {
            Feedback::Hello { challenge, .. } => asked = Some(challenge),
            other => panic!("{other:?}"),
        });
        let (challenge, session) = (asked.unwrap(), seals.session());
        let welcome = Feedback::Welcome { name: NAME, challenge, session, sequence: 1, history: 1024 };
        assert!(intake.hear(now.steady_ns, &writer, &welcome));
        (writer, seals)
    });
    let mut segments = Segments::new();
    seals[0].1.seal(now.unix_ns, Encoding::Bytes, b"message", 1000, &mut segments).unwrap();
    let frame = segments.iter().next().unwrap().to_vec();
    let writers = [seals[0].0, seals[1].0];
    intake.push(now, writers[1], &frame, true, &counters);
    intake.push(now, writers[0], &frame, true, &counters);
    let mut marks = HashMap::new();
    for later in 1..100 {
        intake.poll(now.steady_ns + later * 10_000_000, &counters, |writer, said| {
            if let Feedback::Report { ce, .. } = said {
                marks.insert(*writer, ce);
            }
        });
    }
    assert_eq!(marks.get(&writers[0]), Some(&1), "its own frame had a mark");
    assert!(marks.get(&writers[1]).is_none_or(|ce| *ce == 0), "and the other's none: {marks:?}");
}

/// The clock of the reader is an hour ahead. The writer's answer, and not the age of a message,
/// tells that; the answer to another question tells nothing.
#[test]
fn a_writer_whose_messages_are_too_old_is_asked_for_its_time() {
    let (queue, mut messages) = mpsc::channel(4);
    let mut intake = SubscriptionReceiver::new(NAME, SubscribeOptions::reliable(), queue, Arc::default());
    let (key, counters, writer) =
        (SigningKey::from_secret_bytes(&[1; 32]).unwrap(), Counters::default(), Name::from_bytes([2; 32]));
    let mut seals = gdp_e2e::seal::Writer::new(NAME, writer, key.clone(), Backend::selected()).unwrap();
    seals.set_epoch(1, &EpochKey::from_bytes([2; 32])).unwrap();
    intake.change(0, Change::Authorise { writer, key: key.verify_key() });
    let opened = Opened { epoch: 1, key: EpochKey::from_bytes([2; 32]), dropped: None };
    intake.change(0, Change::Key { writer, opened });
    let mut said = Vec::new();
    intake.poll(0, &counters, |_, feedback| said.push(feedback));
    let [Feedback::Hello { challenge, .. }] = said[..] else { panic!("{said:?}") };
    let session = seals.session();
    let welcome = Feedback::Welcome { name: NAME, challenge, session, sequence: 1, history: 1024 };
    assert!(intake.hear(0, &writer, &welcome));

    const HOUR: u64 = 3600 * 1_000_000_000;
    let (writers_time, mut segments) = (unix_nanos() - HOUR, Segments::new());
    let mut asked = Vec::new();
    for now in [1_000_000, 2_000_000] {
        seals.seal(writers_time, Encoding::Bytes, b"message", 1000, &mut segments).unwrap();
        let now = Timestamps { steady_ns: now, unix_ns: unix_nanos() };
        intake.push(now, writer, segments.iter().next().unwrap(), false, &counters);
        intake.poll(now.steady_ns, &counters, |_, feedback| {
            if let Feedback::Clock { session, challenge, unix_ns, .. } = feedback {
                asked.push((session, challenge, unix_ns));
            }
        });
    }
    assert!(messages.try_recv().is_err());
    let [(of, challenge, unix_ns)] = asked[..] else { panic!("{asked:?}") };
    assert_eq!(of, session);
    assert!(unix_ns.abs_diff(unix_nanos()) < 60 * 1_000_000_000, "the reader's time");
    assert_eq!(intake.clock_answer(3_000_000, &writer, &[0; 16], writers_time), None);
    let ahead = intake.clock_answer(3_000_000, &writer, &challenge, writers_time).unwrap();
    assert!((ahead + HOUR as i64).unsigned_abs() < 60_000_000_000, "{ahead}");
    assert_eq!(intake.clock_answer(3_000_000, &writer, &challenge, 0), None, "a recording");
}
