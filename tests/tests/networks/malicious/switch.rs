//! A malicious switch. It carries the frames and has the link keys, but none of the keys of the
//! frames' content.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use gdp::unstable::{PublishOptions, SubscribeOptions};
use gdp_core::identity::Identity;
use gdp_e2e::keys::PAIR_VERSION;
use gdp_e2e::seal::Encoding;
use gdp_wire::Name;
use tokio::runtime::Handle;
use tokio::time::timeout;

use crate::evil::{Frame, Owner, Recording, Scene, dropped, eventually, node};
use crate::patient::patient;
use gdp_tests::wait::TIMEOUT;

/// A change to a payload.
type Alter = Box<dyn Fn(&mut Vec<u8>) + Send>;

/// Messages of a test.
const COUNT: u8 = 30;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_switch_alters_is_dropped() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let topic = scene.owner.name();
    let flip = |at: usize| move |payload: &mut Vec<u8>| payload[at] ^= 0x40;
    let flip_from_behind = |at: usize| {
        move |payload: &mut Vec<u8>| {
            let at = payload.len() - at;
            payload[at] ^= 0x40;
        }
    };
    let cut = |payload: &mut Vec<u8>| _ = payload.pop();
    let cases: [(&str, Alter, &str); _] = [
        ("version", Box::new(flip(0)), "seal_other_version"),
        ("flags", Box::new(flip(1)), "seal_forged"),
        ("length", Box::new(flip(2)), "seal_bad_header"),
        ("sequence", Box::new(flip(10)), "seal_forged"),
        ("session", Box::new(flip(20)), "seal_forged"),
        ("epoch", Box::new(flip(42)), "seal_no_key"),
        ("content", Box::new(flip(50)), "seal_forged"),
        ("signature", Box::new(flip_from_behind(30)), "seal_forged"),
        ("tag", Box::new(flip_from_behind(1)), "seal_forged"),
        ("end", Box::new(cut), "seal_truncated"),
    ];
    for (part, alter, reason) in cases {
        let before = dropped(&scene.cloud.counters(), reason);
        scene.switch.tamper(move |frames| {
            frames.iter_mut().filter(|frame| frame.destination == topic).for_each(|frame| alter(&mut frame.payload));
        });
        scene.send(part.as_bytes()).await?;
        scene.drops(reason, before + 1)?;
        assert!(scene.delivered().await.is_empty(), "{part}");
        scene.switch.tamper(|_| {});
        // Repairs arrive unaltered.
        scene.send(b"true").await?;
        while scene.next().await?.body != b"true"[..] {}
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_switch_alters_or_drops_is_repaired_if_it_lets_the_repair_through() -> Result<()> {
    let mut scene = Scene::reliable().await?;
    let topic = scene.owner.name();
    let mut seen = BTreeSet::new();
    scene.switch.tamper(move |frames| {
        // Changes each frame the first time it passes, except heartbeats, which never repeat.
        frames.retain_mut(|frame| {
            if frame.destination != topic || frame.payload[1] == 2 || !seen.insert(segment(&frame.payload)) {
                return true;
            }
            let last = frame.payload.len() - 1;
            frame.payload[last] ^= 1;
            seen.len() % 3 != 0
        });
    });
    for i in 0..COUNT {
        scene.send(&vec![i; 3000]).await?;
    }
    for i in 0..COUNT {
        assert_eq!(scene.next().await?.body, vec![i; 3000], "each once and in order");
    }
    scene.drops("seal_forged", 1)?;
    Ok(())
}

/// Returns session, sequence number, cut and index of the first segment in a payload
/// (docs/wire-format.md).
fn segment(payload: &[u8]) -> Vec<u8> {
    payload[4..32].to_vec()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_switch_repeats_is_delivered_once() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let topic = scene.owner.name();
    scene.switch.tamper(move |frames| {
        let again: Vec<Frame> = frames.iter().filter(|frame| frame.destination == topic).cloned().collect();
        frames.extend(again.iter().cloned());
        frames.extend(again);
    });
    for i in 0..COUNT {
        scene.passes(&[i; 100]).await?;
    }
    // Each arrives twice too often. On a busy machine the reader requests a few again, and these
    // arrive three more times.
    let (repeats, few) = (2 * u64::from(COUNT), 3 * 10);
    let counters = scene.drops("seal_duplicate", repeats)?;
    let dropped = dropped(&counters, "seal_duplicate");
    assert!((repeats..=repeats + few).contains(&dropped), "{dropped}");
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_switch_sends_in_another_order_is_put_right_or_overtaken() -> Result<()> {
    for reliable in [true, false] {
        let mut scene = if reliable { Scene::reliable().await? } else { Scene::best_effort().await? };
        let (topic, mut late) = (scene.owner.name(), Vec::new());
        scene.switch.tamper(move |frames| {
            // Delays three at a time, and reverses their order.
            let (of_topic, others) = frames.drain(..).partition(|frame: &Frame| frame.destination == topic);
            (*frames, late) = (others, [std::mem::take(&mut late), of_topic].concat());
            if late.len() >= 3 {
                frames.extend(late.drain(..).rev());
            }
        });
        for i in 0..COUNT {
            scene.send(&[i; 100]).await?;
        }
        scene.switch.tamper(|_| {});
        scene.send(b"last").await?;
        let mut received = Vec::new();
        while received.last().is_none_or(|body: &Vec<u8>| body != b"last") {
            received.push(scene.next().await?.body.to_vec());
        }
        received.pop();
        let numbers: Vec<u8> = received.iter().map(|body| body[0]).collect();
        if reliable {
            assert_eq!(numbers, (0..COUNT).collect::<Vec<_>>());
        } else {
            assert!(numbers.is_sorted_by(|a, b| a < b), "an older one behind a newer: {numbers:?}");
            // Every loss was counted.
            let counts = scene.subscription.counters().inbound;
            assert_eq!(counts.delivered as usize, numbers.len() + 2);
            assert_eq!(counts.delivered + counts.overtaken + counts.expired, u64::from(COUNT) + 2, "{counts:?}");
        }
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_switch_makes_up_is_dropped() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let (topic, robot, cloud) = (scene.owner.name(), scene.robot.name(), scene.cloud.name());
    let stranger = Identity::generate("proxy")?.name();
    let recording = Recording::of(&scene.switch);
    scene.passes(b"true").await?;
    let frames = recording.frames();
    let honest = frames.iter().find(|frame| frame.destination == topic).expect("a frame of the topic");
    let made_up = |destination, source, payload: &[u8]| {
        let (flags, payload, to) = (0, payload.to_vec(), vec![cloud]);
        Frame { destination, source, flags, payload, to }
    };
    let mut other_sequence = honest.payload.clone();
    other_sequence[11] ^= 1;
    for (reason, frame) in [
        ("seal_truncated", made_up(topic, robot, &[])),
        ("seal_other_version", made_up(topic, robot, &[0xff; 1000])),
        ("seal_forged", made_up(topic, robot, &other_sequence)),
        ("seal_unknown_writer", made_up(topic, stranger, &honest.payload)),
        ("drop_not_subscribed", made_up(stranger, robot, &honest.payload)),
        ("drop_feedback_unknown", made_up(cloud, stranger, &[1; 100])),
        ("drop_feedback_malformed", made_up(cloud, robot, &[1; 100])),
        ("drop_feedback_forged", made_up(cloud, robot, &[PAIR_VERSION; 100])),
    ] {
        scene.switch.inject(&vec![frame; 10]);
        scene.drops(reason, 10)?;
    }
    scene.passes(b"still true").await
}

/// A frame with a repeated segment, and behind it one that no writer sealed. An unauthentic segment
/// must not count as received, or later messages would be considered old.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_hidden_behind_a_true_segment_moves_nothing() -> Result<()> {
    for reliable in [false, true] {
        let mut scene = if reliable { Scene::reliable().await? } else { Scene::best_effort().await? };
        let recording = Recording::of(&scene.switch);
        scene.passes(b"true").await?;
        let topic = scene.owner.name();
        let frames = recording.frames();
        let honest = frames.iter().find(|frame| frame.destination == topic).expect("a frame of the topic");
        let mut far = honest.payload.clone();
        far[8..14].copy_from_slice(&[0, 0, 0, 1, 0, 0]);
        let mut frame = honest.clone();
        frame.payload.extend(far);
        scene.switch.inject(&vec![frame; 10]);
        // A reliable reader has no room this far ahead, whatever else the frame contains.
        let reason = if reliable { "drop_no_room" } else { "seal_duplicate" };
        scene.drops(reason, 10)?;
        for i in 0..COUNT {
            scene.passes(&[i; 10]).await?;
        }
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_restarted_reader_does_not_take_yesterdays_messages() -> Result<()> {
    for robot_restarts in [false, true] {
        let mut scene = Scene::best_effort().await?;
        let recording = Recording::of(&scene.switch);
        for i in 0..COUNT {
            scene.passes(&[i; 10]).await?;
        }
        let Scene { publisher, subscription, robot, cloud, robot_identity, cloud_identity, owner, switch } = scene;
        drop(subscription);
        cloud.close().await;
        let (robot, mut publisher) = match robot_restarts {
            false => (robot, publisher),
            true => {
                drop(publisher);
                robot.close().await;
                let robot = node(&switch, &robot_identity).await?;
                let publisher = owner.publish(&robot, PublishOptions::best_effort()).await?;
                (robot, publisher)
            }
        };
        let cloud = node(&switch, &cloud_identity).await?;
        let mut subscription = owner.subscribe(&cloud, SubscribeOptions::best_effort()).await?;
        let topic = owner.name();
        let yesterday: Vec<Frame> = recording.frames().into_iter().filter(|frame| frame.destination == topic).collect();
        // Before the reader has heard from the writer, and after.
        switch.inject(&yesterday);
        // Messages sent before the reader has greeted the writer count as yesterday's, too.
        let message = eventually("a message of today", || {
            let sent = async { publisher.send(Encoding::Bytes, b"today").await };
            let heard = async { timeout(Duration::from_millis(20), subscription.recv()).await };
            Handle::current().block_on(async { (sent.await.ok(), heard.await.ok().flatten()) }).1
        })?;
        assert_eq!(&message.body[..], b"today");
        switch.inject(&yesterday);
        // Frames of this session from before the reader's request, or frames of an ended session,
        // sealed with ended keys.
        let reasons: &[&str] = if robot_restarts { &["seal_no_key", "seal_forged"] } else { &["seal_stale"] };
        let refused = || reasons.iter().map(|reason| dropped(&cloud.counters(), reason)).sum::<u64>();
        eventually("all to be refused", || (refused() >= 2 * u64::from(COUNT)).then_some(()))?;
        publisher.send(Encoding::Bytes, b"now").await?;
        while let Some(message) = timeout(TIMEOUT, subscription.recv()).await? {
            match &message.body[..] {
                b"today" => {}
                other => {
                    assert_eq!(other, b"now");
                    break;
                }
            }
        }
        drop((publisher, robot));
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_switch_holds_back_for_too_long_is_too_old() -> Result<()> {
    const MAX_AGE: Duration = Duration::from_secs(3);
    let (publishing, mut reading) = patient();
    reading.limits.max_age = MAX_AGE;
    let mut scene = Scene::set(publishing, reading).await?;
    let topic = scene.owner.name();
    let held = Recording::default();
    let holding = held.clone();
    scene.switch.tamper(move |frames| {
        let of_topic = frames.extract_if(.., |frame| frame.destination == topic);
        holding.add(&of_topic.collect::<Vec<_>>());
    });
    scene.send(b"stop here").await?;
    let sent = Instant::now();
    let recorded = eventually("the message to be too old", || {
        Some(held.frames()).filter(|frames| !frames.is_empty() && sent.elapsed() > MAX_AGE)
    })?;
    scene.switch.tamper(|_| {});
    scene.switch.inject(&recorded);
    scene.drops("seal_too_old", 1)?;
    scene.passes(b"go on").await
}

/// Readers' feedback from before the writer's restart opens once more, because the writer remembers
/// nothing. It must not cost a reader any message.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_readers_said_yesterday_moves_nothing_at_a_restarted_writer() -> Result<()> {
    let mut scene = Scene::reliable().await?;
    let recording = Recording::of(&scene.switch);
    for i in 0..COUNT {
        scene.passes(&[i; 10]).await?;
    }
    let Scene { publisher, mut subscription, robot, robot_identity, owner, switch, cloud, .. } = scene;
    let (topic, to_robot) = (owner.name(), robot.name());
    drop(publisher);
    robot.close().await;
    let robot = node(&switch, &robot_identity).await?;
    let mut publisher = owner.publish(&robot, PublishOptions::reliable()).await?;
    publisher.send(Encoding::Bytes, b"hello").await?;
    assert!(timeout(TIMEOUT, subscription.recv()).await?.is_some());
    drop(publisher);
    robot.close().await;
    let said: Vec<Frame> = recording.frames().into_iter().filter(|frame| frame.destination == to_robot).collect();
    assert!(!said.is_empty());

    let robot = node(&switch, &robot_identity).await?;
    let mut publisher = owner.publish(&robot, PublishOptions::reliable()).await?;
    publisher.send(Encoding::Bytes, b"hello").await?;
    assert!(timeout(TIMEOUT, subscription.recv()).await?.is_some());
    // Every other message needs a repair while the recorded feedback is repeated.
    let mut seen = BTreeSet::new();
    switch.tamper(move |frames| {
        frames.retain(|frame| {
            frame.destination != topic
                || frame.payload[1] == 2
                || !seen.insert(segment(&frame.payload))
                || seen.len() % 2 == 0
        });
        frames.extend_from_slice(&said);
    });
    for i in 0..COUNT {
        publisher.send(Encoding::Bytes, &[i; 10]).await?;
    }
    for i in 0..COUNT {
        let message = timeout(TIMEOUT, subscription.recv())
            .await
            .with_context(|| format!("{i}: {:?} {:?}", robot.counters(), cloud.counters()))?;
        assert_eq!(message.map(|message| message.body).as_deref(), Some(&[i; 10][..]), "each once and in order");
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frames_moved_to_another_name_writer_or_session_do_not_open() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let (switch, cloud) = (&scene.switch, &scene.cloud);
    // The cloud also reads another name, from the same robot and from a second one.
    let (other, second) = (Owner::new("/other")?, node(switch, &Identity::generate("proxy")?).await?);
    let mut others = other.subscribe(cloud, SubscribeOptions::best_effort()).await?;
    let options = PublishOptions::best_effort();
    let mut from_robot = other.publish(&scene.robot, options).await?;
    let mut from_second = other.publish(&second, options).await?;
    let recording = Recording::of(switch);
    for publisher in [&mut from_robot, &mut from_second] {
        publisher.send(Encoding::Bytes, b"other").await?;
        assert!(timeout(TIMEOUT, others.recv()).await?.is_some());
    }
    scene.passes(b"true").await?;
    let frames = recording.frames();
    let of = |destination: Name, source: Name| {
        let mut of = frames.iter().filter(|f| f.destination == destination && f.source == source);
        of.next().expect("a frame").clone()
    };
    let (topic, robot) = (scene.owner.name(), scene.robot.name());
    let (a, b, c) = (of(topic, robot), of(other.name(), robot), of(other.name(), second.name()));
    let before = scene.cloud.counters();
    let mut session = a.clone();
    session.payload[16..32].copy_from_slice(&b.payload[16..32]);
    let moved = [
        Frame { destination: other.name(), ..a.clone() },
        Frame { destination: topic, ..b.clone() },
        Frame { source: robot, ..c },
        session,
    ];
    scene.switch.inject(&moved);
    // Epochs may have the same number.
    let refused = || {
        let now = scene.cloud.counters();
        let more = |reason| dropped(&now, reason) - dropped(&before, reason);
        (more("seal_forged") + more("seal_no_key") == 4).then_some(())
    };
    eventually("all to be refused", refused)
        .with_context(|| format!("{:?}, before {before:?}", scene.cloud.counters()))?;
    scene.passes(b"still true").await?;
    from_robot.send(Encoding::Bytes, b"still other").await?;
    let message = timeout(TIMEOUT, others.recv()).await?;
    assert_eq!(message.map(|message| message.body).as_deref(), Some(&b"still other"[..]));
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_readable_passes_a_switch() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let recording = Recording::of(&scene.switch);
    let secret = b"attack at dawn, and bring the robot";
    scene.passes(secret).await?;
    let card = scene.owner.card.to_json();
    for frame in recording.frames() {
        for needle in [&secret[..], b"/chatter", b"chatter"] {
            assert!(!frame.payload.windows(needle.len()).any(|window| window == needle));
        }
    }
    assert!(card.contains("chatter"), "those who hold the card do know");
    Ok(())
}
