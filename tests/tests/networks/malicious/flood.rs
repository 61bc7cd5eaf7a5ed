//! An attacker that sends as fast as it can on a link with legitimate traffic. `cargo xtask bench
//! transport` measures the rate of that traffic. These tests check that the traffic arrives and
//! that memory does not grow.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use gdp_core::crypto;
use gdp_core::crypto::Backend;
use gdp_core::identity::Identity;
use gdp_e2e::keys::PAIR_VERSION;
use gdp_e2e::seal::Writer;
use gdp_proto::control::{NameRole, Response};
use gdp_wire::Name;

use crate::evil::{Frame, Recording, Rogue, Scene, dropped};

/// Least number of flood frames that are dropped.
const FRAMES: u64 = 3_000;

/// Most messages of legitimate traffic beside a flood.
const MESSAGES: u32 = 200_000;

/// Limit of the process's growth in KiB. Segments that wait for a key or a writer take 2 MiB;
/// sockets and recordings take little.
const MEMORY: u64 = 48 << 10;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_of_what_is_not_authentic_stops_nobody_and_takes_no_memory() -> Result<()> {
    let mut scene = Scene::reliable().await?;
    let mut rogue = Rogue::attach(&scene.switch)?;
    let stated = rogue.state(&scene.switch, &scene.owner, NameRole::Subscriber)?;
    assert!(matches!(stated, Response::Peers(_)), "{stated:?}");
    let recording = Recording::of(&scene.switch);
    scene.passes(b"before").await?;
    let (topic, robot, cloud) = (scene.owner.name(), scene.robot.name(), scene.cloud.name());
    let honest = recording.frames().into_iter().find(|frame| frame.destination == topic).context("no frame")?;
    scene.switch.tamper(|_| {});
    let to_cloud = |destination: Name, source: Name, payload: Vec<u8>| Frame {
        destination,
        source,
        flags: 0,
        payload,
        to: vec![cloud],
    };
    // Each kind passes as many checks as it can before it is dropped.
    let mut changed = honest.payload.clone();
    let last = changed.len() - 1;
    changed[last] ^= 1;
    let mut far = Writer::new(topic, robot, rogue.identity.key().clone(), Backend::selected())?;
    far.set_epoch(7, &gdp_core::keys::EpochKey::generate()?)?;
    // The version of feedback, so that only its tag is wrong.
    let feedback = [&[PAIR_VERSION][..], &crypto::random::<100>()?].concat();
    let kinds = [
        // First, because the frame is too old on a machine that takes a minute for the others.
        ("seal_duplicate", vec![honest.clone()]),
        ("seal_forged", vec![to_cloud(topic, robot, changed)]),
        ("seal_unknown_writer", vec![to_cloud(topic, Identity::generate("proxy")?.name(), honest.payload.clone())]),
        ("seal_no_key", rogue.sealed(&mut far, robot, &[1; 900], cloud)?),
        ("drop_feedback_forged", vec![to_cloud(cloud, robot, feedback)]),
    ];
    let before = resident()?;
    for (reason, mut frames) in kinds {
        frames.iter_mut().for_each(|frame| frame.to = vec![cloud]);
        let ends = Arc::new(AtomicBool::new(false));
        let flood = scene.switch.flood(frames, ends.clone());
        let mut passed = 0u32;
        let flooded = loop {
            scene.passes(&passed.to_be_bytes()).await.context(reason)?;
            passed += 1;
            let now = scene.cloud.counters();
            if passed >= 100 && dropped(&now, reason) >= FRAMES {
                break now;
            }
            assert!(passed < MESSAGES, "the flood is not counted as {reason}: {:?}", now.drops);
        };
        ends.store(true, Ordering::Relaxed);
        flood.join().ok().context("the flood failed")?;
        assert!(flooded.frames_received >= FRAMES);
    }
    let grown = resident()?.saturating_sub(before);
    assert!(grown < MEMORY, "{grown} KiB more than before");
    Ok(())
}

/// Returns the resident memory of this process in KiB.
fn resident() -> Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).context("no VmRSS")?;
    Ok(line.split_whitespace().nth(1).context("no number")?.parse()?)
}
