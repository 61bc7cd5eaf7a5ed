//! Measures whether messages at a fixed rate arrive while an attacker floods their link. The
//! flood's frames are replayed, or their tag fits no key: the attacker lacks the link's keys. Both
//! ends share one CPU; the attacker has the other. The figures also show the receiving end's drops
//! and its memory use.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use gdp_tests::measure::cpu;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, alternate};
use gdp_tests::packet::{ETHERNET, PacketSocket, is_gdp_data};

use crate::lane::Load;
use crate::run::Seen;
use crate::site::{Cable, Site};
use crate::{Bench, ours, run};

/// The attacker's frames.
#[derive(Clone, Copy)]
enum Forgery {
    /// A frame that was on the link before, repeated.
    Replayed,
    /// A frame with another counter and a tag that fits no key.
    Untagged,
}

/// Frames per second of each kind.
const FLOODS: [(&str, Option<(Forgery, u32)>); 4] = [
    (CALM, None),
    ("50 k replayed frames/s", Some((Forgery::Replayed, 50_000))),
    ("50 k forged frames/s", Some((Forgery::Untagged, 50_000))),
    ("150 k forged frames/s", Some((Forgery::Untagged, 150_000))),
];
const CALM: &str = "no flood";

/// A thousand messages per second.
const LOAD: Load = Load { bytes: 1_000, every: Some(Duration::from_millis(1)) };

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let site = Site::build(Cable::Tapped, bench)?;
    let rounds = RefCell::new(Vec::new());
    let contenders = FLOODS.map(|(series, flood)| {
        let (site, rounds) = (&site, &rounds);
        Contender::new(series, "messages, arrived", move || {
            let (seen, rate) = beside(site, flood, bench)?;
            let lane = &seen.lanes[0];
            let sample = lane.sample(lane.rate);
            rounds.borrow_mut().push((series, rate, seen));
            Ok(sample)
        })
    });
    let mut measures = alternate(bench.rounds, contenders.into())?;
    let rounds = rounds.into_inner();
    // The first round warms up.
    let of = |series: &'static str| rounds.iter().filter(move |(of, ..)| *of == series).skip(1);
    let (mut memory, mut drops) = (Vec::new(), Vec::new());
    for (series, flood) in &FLOODS {
        if flood.is_some() {
            let rates = of(series).map(|(_, rate, _)| *rate).collect();
            measures.push(Measure::new(series, "frames of the attacker, sent", rates));
        }
        for (index, case) in ["before", "after"].into_iter().enumerate() {
            let resident = of(series).map(|(.., seen)| seen.resident[index]).collect();
            memory.push(Measure::new(series, case, resident));
        }
        let reasons: BTreeSet<&str> = of(series).flat_map(|(.., seen)| seen.drops.keys().copied()).collect();
        for reason in reasons {
            let rates = of(series).map(|(.., seen)| seen.drops.get(reason).copied().unwrap_or(0.0)).collect();
            drops.push(Measure::new(series, reason, rates));
        }
    }
    let title = "A thousand messages of 1 kB per second, beside a flood on their link";
    let figure = Figure::new("transport-flood", title, Unit::MessagesPerSecond, measures);
    Ok(vec![
        FLOODS[1..]
            .iter()
            .fold(figure, |figure, (series, _)| figure.compare(series, CALM, |_| Some(Aim::AtLeast(0.98)))),
        Figure::new("transport-flood-drops", "What the receiving end dropped", Unit::FramesPerSecond, drops),
        Figure::new("transport-flood-memory", "Resident memory of both ends", Unit::Bytes, memory),
    ])
}

/// Returns the result during a flood, and the flood's frames per second.
fn beside(site: &Site, flood: Option<(Forgery, u32)>, bench: &Bench) -> Result<(Seen, f64)> {
    let (tap, attacker) = (site.chain().wire_from_robot()?, site.chain().wire_to_cloud()?);
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let attack = flood.map(|(forgery, rate)| {
            let (tap, attacker, ended) = (&tap, &attacker, &ended);
            scope.spawn(move || attack(tap, attacker, forgery, rate, ended))
        });
        let seen = run::run(site, ours::best_effort_on_ethernet, &[LOAD], [cpu::SENDER; 2], bench.long_duration());
        ended.store(true, Ordering::Relaxed);
        let rate = match attack.map(|attack| attack.join()) {
            Some(Ok(rate)) => rate?,
            Some(Err(_)) => anyhow::bail!("the attacker panicked"),
            None => 0.0,
        };
        Ok((seen?, rate))
    })
}

/// Floods until `ended` is set and returns frames per second.
fn attack(tap: &PacketSocket, attacker: &PacketSocket, forgery: Forgery, rate: u32, ended: &AtomicBool) -> Result<f64> {
    const SOON: Duration = Duration::from_secs(10);
    cpu::pin(cpu::OTHER)?;
    let mut frame = tap.receive(SOON, is_gdp_data).context("a frame to forge")?;
    let (begun, mut sent) = (Instant::now(), 0_u32);
    while !ended.load(Ordering::Relaxed) {
        if begun.elapsed().mul_f64(rate.into()) < Duration::from_secs(sent.into()) {
            std::hint::spin_loop();
            continue;
        }
        if let Forgery::Untagged = forgery {
            // The low half of the frame's counter.
            frame[ETHERNET + 12..ETHERNET + 16].copy_from_slice(&(u32::MAX / 2 + sent).to_be_bytes());
        }
        attacker.send(&frame)?;
        sent += 1;
    }
    Ok(f64::from(sent) / begun.elapsed().as_secs_f64())
}
