//! An attacker on the cable between s1 and s2 replays, cuts, flips and invents frames. None of it reaches ROS, and every
//! frame is counted under a reason.

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions, PATIENCE};
use gdp_tests::packet::{ETHERNET, PacketSocket, is_gdp_data};
use gdp_tests::peers::{self, Conversation, Side, Traffic, Vendor};
use gdp_tests::wait::wait_for;
use serde_json::Value;

/// Bytes of the GDP header.
const HEADER: usize = 96;

/// Index of the switch that the attacker's frames reach first.
const S2: usize = 1;

struct Scene {
    fabric: Fabric,
    conversation: Conversation,
    attacker: PacketSocket,
    /// A data frame that passed: Ethernet, header, sealed message.
    frame: Vec<u8>,
}

impl Scene {
    /// A fabric in which messages flow, with one of them captured.
    fn set() -> Result<Self> {
        let chain = ChainOptions { wire: Some(1), ..Default::default() };
        let mut fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions { chain, ..Default::default() })?;
        fabric.start_proxies()?;
        let traffic = Traffic::default();
        let talks = Side { at: fabric.chain.robot(), vendor: Vendor::Cyclone, traffic: &traffic };
        let hears = Side { at: fabric.chain.cloud(), vendor: Vendor::FastDds, traffic: &traffic };
        let conversation = Conversation::start(&fabric.tools, talks, hears, fabric.folder())?;
        let eavesdropper = fabric.chain.wire_from_robot()?;
        conversation.open()?;
        let frame = eavesdropper.receive(PATIENCE, is_gdp_data)?;
        let attacker = fabric.chain.wire_to_cloud()?;
        Ok(Self { fabric, conversation, attacker, frame })
    }

    /// Sends hostile frames and waits until s2 has counted as many under `reason`.
    fn refused_by_s2(&self, reason: &str, frames: &[Vec<u8>]) -> Result<()> {
        let before = self.fabric.counter(S2, reason)?;
        self.send(frames)?;
        self.wait_for_count(reason, before + frames.len() as u64, |fabric| fabric.counter(S2, reason))
    }

    /// Sends frames whose header is good; the reader at the far end must refuse each, under `reason`.
    fn refused_by_reader(&self, reason: &str, frames: &[Vec<u8>]) -> Result<()> {
        let count = |fabric: &Fabric| Ok(sum_of(&fabric.proxy_stats("cloud")["node"], reason));
        let before = count(&self.fabric)?;
        self.send(frames)?;
        self.wait_for_count(reason, before + frames.len() as u64, count)
    }

    fn send(&self, frames: &[Vec<u8>]) -> Result<()> {
        frames.iter().try_for_each(|frame| self.attacker.send(frame))
    }

    fn wait_for_count(&self, reason: &str, expected: u64, count: impl Fn(&Fabric) -> Result<u64>) -> Result<()> {
        let waited = wait_for(&format!("{reason} to reach {expected}"), PATIENCE, || {
            Ok((count(&self.fabric)? >= expected).then_some(()))
        });
        waited.with_context(|| {
            let s2 = self.fabric.status(S2).unwrap_or_default();
            format!("s2: {}\ncloud: {}", s2["counters"], self.fabric.proxy_stats("cloud"))
        })
    }

    /// Honest messages still arrive, and nothing else has: every number once, in order, content as written.
    fn only_honest_messages_arrived(mut self) -> Result<()> {
        let so_far = peers::received(&self.conversation.listener).len();
        let messages = self.conversation.listener.wait_until("ten more messages", PATIENCE, |p| {
            Some(peers::received(p)).filter(|messages| messages.len() >= so_far + 10)
        })?;
        ensure!(messages.iter().all(|message| message.intact), "a damaged message reached ROS: {messages:?}");
        let numbers: Vec<i64> = messages.iter().map(|message| message.sequence).collect();
        ensure!(numbers == (0..numbers.len() as i64).collect::<Vec<_>>(), "not each once and in order: {numbers:?}");
        Ok(())
    }

    fn flipped(&self, bit: usize) -> Vec<u8> {
        let mut frame = self.frame.clone();
        frame[ETHERNET + bit / 8] ^= 1 << (bit % 8);
        frame
    }
}

#[test]
fn replayed_frames_are_refused_by_the_reader() -> Result<()> {
    let scene = Scene::set()?;
    scene.refused_by_reader("seal_duplicate", &vec![scene.frame.clone(); 20])?;
    scene.only_honest_messages_arrived()
}

/// Every bit that the hop tag covers, the tag's own included; link id and lengths are found wrong before the tag is.
#[test]
fn flipped_header_bits_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    let flips = |bytes: std::ops::Range<usize>| {
        (bytes.start * 8..bytes.end * 8).map(|bit| scene.flipped(bit)).collect::<Vec<_>>()
    };
    // Flags, hop limit, egress set; reserved; counter, tag, egress bits and names.
    scene.refused_by_s2("drop_bad_tag", &flips(1..4))?;
    scene.refused_by_s2("drop_bad_tag", &flips(7..8))?;
    scene.refused_by_s2("drop_bad_tag", &flips(12..HEADER))?;
    scene.refused_by_s2("drop_no_link", &flips(8..12))?;
    // The payload's length: more than there is, or less than was tagged.
    let (longer, shorter) =
        flips(4..6).into_iter().partition::<Vec<_>, _>(|frame| payload_length(frame) > payload_length(&scene.frame));
    scene.refused_by_s2("drop_truncated", &longer)?;
    scene.refused_by_s2("drop_bad_tag", &shorter)?;
    // Header length; version and type, but for the lowest bit, which makes a control frame.
    scene.refused_by_s2("drop_unknown", &flips(6..7))?;
    scene.refused_by_s2("drop_unknown", &(1..8).map(|bit| scene.flipped(bit)).collect::<Vec<_>>())?;
    scene.refused_by_s2("control", &[scene.flipped(0)])?;
    scene.only_honest_messages_arrived()
}

#[test]
fn flipped_payload_bits_are_refused_by_the_reader() -> Result<()> {
    let scene = Scene::set()?;
    let payload = (HEADER * 8..(scene.frame.len() - ETHERNET) * 8).step_by(7);
    let frames: Vec<_> = payload.map(|bit| scene.flipped(bit)).collect();
    let refused = |fabric: &Fabric| Ok(all_drops(&fabric.proxy_stats("cloud")["node"]));
    let before = refused(&scene.fabric)?;
    scene.send(&frames)?;
    scene.wait_for_count("all drops of the reader", before + frames.len() as u64, refused)?;
    scene.only_honest_messages_arrived()
}

#[test]
fn truncated_frames_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    let cuts: Vec<_> = (ETHERNET + 1..scene.frame.len()).map(|length| scene.frame[..length].to_vec()).collect();
    scene.refused_by_s2("drop_truncated", &cuts)?;
    scene.only_honest_messages_arrived()
}

/// Frames of somebody who knows the format, the names and the link, but not the link's key.
#[test]
fn forged_frames_are_refused_by_the_next_switch() -> Result<()> {
    let scene = Scene::set()?;
    let forged: Vec<_> = (0..200u64)
        .map(|n| {
            let mut frame = scene.frame.clone();
            let guess = n.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes();
            frame[ETHERNET + 16..ETHERNET + 24].copy_from_slice(&guess);
            frame
        })
        .collect();
    scene.refused_by_s2("drop_bad_tag", &forged)?;
    scene.only_honest_messages_arrived()
}

fn payload_length(frame: &[u8]) -> u16 {
    u16::from_be_bytes([frame[ETHERNET + 4], frame[ETHERNET + 5]])
}

/// The number under `key`, wherever it is.
fn sum_of(value: &Value, key: &str) -> u64 {
    match value {
        Value::Object(fields) => fields
            .iter()
            .map(|(k, v)| if k == key { v.as_u64().unwrap_or_else(|| sum_of(v, key)) } else { sum_of(v, key) })
            .sum(),
        Value::Array(values) => values.iter().map(|v| sum_of(v, key)).sum(),
        _ => 0,
    }
}

/// All numbers under any `drops`.
fn all_drops(value: &Value) -> u64 {
    fn total(value: &Value) -> u64 {
        match value {
            Value::Object(fields) => fields.values().map(total).sum(),
            other => other.as_u64().unwrap_or(0),
        }
    }
    match value {
        Value::Object(fields) => {
            fields.iter().map(|(key, v)| if key == "drops" { total(v) } else { all_drops(v) }).sum()
        }
        Value::Array(values) => values.iter().map(all_drops).sum(),
        _ => 0,
    }
}
