//! Malicious readers: one with a grant and therefore the content keys, one without, one whose right
//! was revoked; and a writer whose right was revoked.

use std::time::Instant;

use anyhow::Result;
use gdp::unstable::{PublishOptions, SubscribeOptions};
use gdp_core::crypto::Backend;
use gdp_e2e::feedback_wire::{Feedback, Missing};
use gdp_e2e::keys::PairKey;
use gdp_e2e::seal::{Encoding, Segments, Writer};
use gdp_proto::control::{NameRole, RefusalCode, Response};
use gdp_wire::Name;

use super::rib::revoke;
use crate::evil::{Frame, Recording, Rogue, Scene, bodies, dropped, drops, eventually, frames, serial};
use gdp_tests::wait::TIMEOUT;

/// Attaches a reader of the scene's name, with a grant and the robot's present key.
fn insider(scene: &Scene) -> Result<Rogue> {
    let (switch, owner) = (&scene.switch, &scene.owner);
    let mut rogue = Rogue::attach(switch)?;
    let stated = rogue.state(switch, owner, NameRole::Subscriber)?;
    assert!(matches!(stated, Response::Peers(_)), "{stated:?}");
    rogue.await_key(switch, owner.name(), &scene.robot_identity)?;
    Ok(rogue)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_cannot_write_though_it_holds_the_key() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let rogue = insider(&scene)?;
    let (name, robot, cloud) = (scene.owner.name(), scene.robot.name(), scene.cloud.name());
    let recording = Recording::of(&scene.switch);
    scene.passes(b"true").await?;
    let passed = recording.frames();
    assert_eq!(bodies(&rogue.read(name, &scene.robot_identity, &passed)?), [b"true"], "the key is the right one");
    let (epoch, key) = rogue.keys(name, &scene.robot_identity).pop().expect("a key");

    // In a session of the rogue's own, as the robot.
    let mut writer = Writer::new(name, robot, rogue.identity.key().clone(), Backend::selected())?;
    writer.set_epoch(epoch, &key)?;
    scene.switch.inject(&rogue.sealed(&mut writer, robot, b"forged", cloud)?);
    scene.drops("seal_unvouched", 1)?;
    let mut heartbeat = Segments::new();
    writer.heartbeat(0, 1, 1, &mut heartbeat)?;
    scene.switch.inject(&frames(&heartbeat, name, robot, cloud));
    scene.drops("seal_unvouched", 2)?;
    // Under the rogue's own name.
    let mut writer = Writer::new(name, rogue.name(), rogue.identity.key().clone(), Backend::selected())?;
    writer.set_epoch(epoch, &key)?;
    scene.switch.inject(&rogue.sealed(&mut writer, rogue.name(), b"forged", cloud)?);
    scene.drops("seal_unknown_writer", 1)?;

    // In the robot's session, which the frames contain: in place of the next message, and far
    // ahead.
    let honest = passed.iter().find(|frame| frame.destination == name).expect("a frame of the topic");
    for ahead in [1, 5_000, 1 << 40] {
        let before = dropped(&scene.cloud.counters(), "seal_bad_signature");
        scene.switch.inject(&[rogue.resealed(honest, (name, &scene.robot_identity), ahead, cloud)?]);
        scene.drops("seal_bad_signature", before + 1)?;
        scene.passes(b"true").await?;
    }
    scene.passes(b"still true").await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_another_says_to_a_reader_or_writer_does_not_open() -> Result<()> {
    let mut scene = Scene::reliable().await?;
    let rogue = insider(&scene)?;
    let recording = Recording::of(&scene.switch);
    scene.passes(b"true").await?;
    let name = scene.owner.name();
    let passed = recording.frames();
    let honest = passed.iter().find(|frame| frame.destination == name).expect("a frame of the topic");
    let mut session = [0; 16];
    session.copy_from_slice(&honest.payload[16..32]);
    let (robot, cloud) = (&scene.robot_identity, &scene.cloud_identity);
    // A Welcome of the robot to the cloud, and a Nack of the cloud to the robot, both made by the
    // rogue.
    let welcome = Feedback::Welcome { name, challenge: [0; 16], session: [7; 16], sequence: 1, history: 1024 };
    let nack =
        Feedback::Nack { name, session, highest: 0, highest_index: 0, waited_us: 0, missing: vec![Missing::whole(1)] };
    let gone = Feedback::Unavailable { name, session, oldest: 1 << 40 };
    for (as_whom, to, node, feedback) in
        [(robot, cloud, &scene.cloud, welcome), (robot, cloud, &scene.cloud, gone), (cloud, robot, &scene.robot, nack)]
    {
        let key = PairKey::new((rogue.name(), rogue.identity.box_key()), (to.name(), &to.box_public()))?;
        let (mut sealer, mut payload) = (key.sealer()?, Vec::new());
        sealer.seal(&[feedback], &mut payload)?;
        let frame = say(as_whom.name(), to.name(), payload);
        let before = dropped(&node.counters(), "drop_feedback_forged");
        scene.switch.inject(&vec![frame; 100]);
        drops(node, "drop_feedback_forged", before + 100)?;
    }
    // The cloud's own report is accepted once.
    let said = eventually("a report", || {
        let mut passed = recording.frames().into_iter();
        passed.find(|frame| frame.destination == robot.name() && frame.source == cloud.name())
    })?;
    let before = dropped(&scene.robot.counters(), "drop_feedback_replayed");
    scene.switch.inject(&vec![said; 100]);
    drops(&scene.robot, "drop_feedback_replayed", before + 100)?;
    scene.passes(b"still true").await
}

fn say(source: Name, destination: Name, payload: Vec<u8>) -> Frame {
    Frame { destination, source, flags: 0, payload, to: vec![destination] }
}

/// The robot repairs for each reader within a budget: endless requests of one reader do not delay
/// the others.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_that_asks_for_everything_again_and_again_stops_nobody() -> Result<()> {
    let mut scene = Scene::reliable().await?;
    let rogue = insider(&scene)?;
    let recording = Recording::of(&scene.switch);
    for i in 0..100u8 {
        scene.passes(&[i; 1000]).await?;
    }
    let name = scene.owner.name();
    let honest = recording.frames().into_iter().find(|frame| frame.destination == name).expect("a frame");
    let mut session = [0; 16];
    session.copy_from_slice(&honest.payload[16..32]);
    let robot = scene.robot_identity.clone();
    let key = PairKey::new((rogue.name(), rogue.identity.box_key()), (robot.name(), &robot.box_public()))?;
    let mut sealer = key.sealer()?;
    let missing: Vec<Missing> = (2..60).map(Missing::whole).collect();
    let heard = scene.robot.counters().feedback_received;
    for i in 0..100u8 {
        for _ in 0..20 {
            let mut payload = Vec::new();
            sealer.seal(
                &[Feedback::Nack {
                    name,
                    session,
                    highest: 0,
                    highest_index: 0,
                    waited_us: 0,
                    missing: missing.clone(),
                }],
                &mut payload,
            )?;
            scene.switch.inject(&[say(rogue.name(), robot.name(), payload)]);
        }
        scene.passes(&[i; 1000]).await?;
    }
    let asked = eventually("the Nacks to be heard", || {
        Some(scene.robot.counters().feedback_received - heard).filter(|asked| *asked >= 1900)
    })?;
    // Each Nack asked for 58 frames.
    let sent = scene.robot.counters().frames_sent;
    assert!(sent < asked * 58 / 4, "{sent} frames sent for {asked} Nacks");
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_has_no_grant_is_refused_and_what_reaches_it_does_not_open() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let (name, recording) = (scene.owner.name(), Recording::of(&scene.switch));
    let mut rogue = Rogue::attach(&scene.switch)?;
    let grant = gdp_proto::control::Credential::Reader(scene.owner.impostor()?.grant(rogue.name())?);
    match rogue.state_with(&scene.switch, &scene.owner, NameRole::Subscriber, grant)? {
        Response::Refused(refused) => assert_eq!(refused.code, RefusalCode::BadSignature),
        other => panic!("not refused: {other:?}"),
    }
    scene.passes(b"secret").await?;
    rogue.listen(&scene.switch);
    assert!(rogue.boxes().is_empty());
    assert!(rogue.read(name, &scene.robot_identity, &recording.frames())?.is_empty());
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_revoked_reader_reads_nothing_of_the_next_epoch() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let switch = &scene.switch;
    let mut rogue = Rogue::attach(switch)?;
    let grant = scene.owner.grant(rogue.name())?;
    let serial = serial(grant.grant.serials())?;
    rogue.state_with(
        switch,
        &scene.owner,
        NameRole::Subscriber,
        gdp_proto::control::Credential::Reader(grant.clone()),
    )?;
    let (name, recording) = (scene.owner.name(), Recording::of(switch));
    rogue.await_key(switch, name, &scene.robot_identity)?;
    scene.passes(b"before").await?;
    let revocation = scene.owner.revocation(vec![serial])?;
    assert!(matches!(revoke(&scene.switch, &scene.owner, &revocation), Response::Done));
    let before = epoch(&recording, name);
    // The last messages that the rogue reads are those sealed before the writer learned of the
    // revocation and began another epoch.
    let (mut sent, deadline) = (Vec::new(), Instant::now() + TIMEOUT);
    while sent.is_empty() || epoch(&recording, name) == before {
        assert!(Instant::now() < deadline, "the epoch did not change");
        let body = sent.len().to_be_bytes();
        scene.passes(&body).await?;
        sent.push(body);
    }
    scene.passes(b"after").await?;
    rogue.listen(&scene.switch);
    let read = rogue.read(name, &scene.robot_identity, &recording.frames())?;
    let read = bodies(&read);
    assert!(read.contains(&&b"before"[..]));
    assert!(!read.contains(&&b"after"[..]) && !read.contains(&&sent[sent.len() - 1][..]), "{read:?}");
    assert_eq!(read.len(), sent.len(), "of the epoch before it has everything, which is no news to it");
    // The revoked reader also cannot rejoin.
    let stated = rogue.state_with(
        &scene.switch,
        &scene.owner,
        NameRole::Subscriber,
        gdp_proto::control::Credential::Reader(grant),
    )?;
    assert!(matches!(&stated, Response::Refused(refused) if refused.code == RefusalCode::Revoked), "{stated:?}");
    Ok(())
}

/// Returns the epoch of the last frame of the topic.
fn epoch(recording: &Recording, name: Name) -> Option<[u8; 4]> {
    recording.last(name)?.payload.get(40..44)?.try_into().ok()
}

/// The thief of a stolen robot has its key. The robot is revoked as a writer of one name, and as a
/// reader of another.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stolen_robot_that_is_revoked_is_not_heard_and_hears_nothing() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    // The robot reads what the cloud writes.
    let orders = crate::evil::Owner::new("/orders")?;
    let mut subscription = orders.subscribe(&scene.robot, SubscribeOptions::best_effort()).await?;
    let mut publisher = orders.publish(&scene.cloud, PublishOptions::best_effort()).await?;
    publisher.send(Encoding::Bytes, b"go").await?;
    assert!(tokio::time::timeout(TIMEOUT, subscription.recv()).await?.is_some());

    let robot = scene.robot.name();
    for owner in [&scene.owner, &orders] {
        let records = scene.switch.records();
        let of_robot = records.iter().filter(|r| r.name == owner.name() && r.entity == scene.robot_identity.proof());
        let serials = of_robot.map(|record| serial(record.credential.serials())).collect::<Result<Vec<_>>>()?;
        assert_eq!(serials.len(), 1);
        assert!(matches!(revoke(&scene.switch, owner, &owner.revocation(serials)?), Response::Done));
    }
    // The robot's own node reports the revocation; an attacker's would not.
    let error = eventually("the robot to hear of it", || {
        let sent = tokio::runtime::Handle::current().block_on(scene.publisher.send(Encoding::Bytes, b"stolen"));
        sent.err()
    })?;
    assert!(error.to_string().contains("revoked"), "{error}");
    scene.delivered().await;
    let mut thief = Writer::new(scene.owner.name(), robot, scene.robot_identity.key().clone(), Backend::selected())?;
    thief.set_epoch(1, &gdp_core::keys::EpochKey::generate()?)?;
    let rogue = Rogue::attach(&scene.switch)?;
    scene.switch.inject(&rogue.sealed(&mut thief, robot, b"stolen", scene.cloud.name())?);
    scene.drops("seal_unknown_writer", 1)?;
    assert!(scene.delivered().await.is_empty());
    Ok(())
}
