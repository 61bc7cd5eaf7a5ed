//! Nanoseconds that the switch spends on one frame, by `BPF_PROG_TEST_RUN`: no interface, no
//! driver, hot caches.
//!
//! The kernel runs the program on one packet repeatedly, and the packet stays as the program left
//! it. Here a frame therefore leaves on a link with the key of the link it arrived on, and with a
//! counter one higher. Each run then sees a valid, fresh and correctly tagged frame, and the
//! program is the shipped one. Only the hop limit runs out; the packet then starts again.

use std::cell::RefCell;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use aya::maps::DevMap;
use aya::programs::{TestRun, TestRunOptions};
use gdp_dataplane::kernel::{Buffers, KernelPlane};
use gdp_tests::frames::Frame;
use gdp_tests::measure::figure::{Aim, Figure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_wire::{Counter, FibEntry, LinkEntry, LinkRole, Name, SwitchConfig};

use crate::Bench;
use crate::series::{BARE, SWITCH, UNTAGGED};
use crate::traffic::Programs;

/// Runs of the program on one packet, within its hop limit.
const RUNS: u32 = 250;

/// Test runs never send frames, but the frames need an egress interface.
const LOOPBACK: u32 = 1;

const EDGE: &str = "edge: the name is looked up";
const TRANSIT: &str = "transit: by egress bits";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let bare = RefCell::new(Bare::load(&bench.bench_object)?);
    let mut rings = Vec::new();
    for (case, role) in [(EDGE, LinkRole::Endpoint), (TRANSIT, LinkRole::Switch)] {
        rings.push((UNTAGGED, case, Ring::load(&bench.untagged_object, role, false)?));
        rings.push((SWITCH, case, Ring::load(&bench.ebpf_object, role, true)?));
    }
    let mut contenders = Vec::new();
    for (series, case, ring) in &mut rings {
        if *series == UNTAGGED {
            let bare = &bare;
            contenders.push(Contender::new(BARE, *case, || sample(bench.duration(), || bare.borrow_mut().time())));
        }
        contenders.push(Contender::new(series, *case, || sample(bench.duration(), || ring.time())));
    }
    let measures = alternate(bench.rounds, contenders)?;
    rings.iter().try_for_each(|(.., ring)| ring.check())?;
    let figure = Figure::new("cost", "One frame in the switch, by test runs", Unit::Nanoseconds, measures)
        .compare(UNTAGGED, BARE, |case| Some(Aim::AtMost(if case == EDGE { 2.0 } else { 1.5 })))
        .compare(SWITCH, BARE, |_| Some(Aim::AtMost(4.0)))
        .stack([
            (BARE, BARE),
            (UNTAGGED, "decision: links, name or bits, replay window, counters"),
            (SWITCH, "hop tag verified and made anew"),
        ]);
    Ok(vec![figure])
}

/// Returns nanoseconds per run: the mean of the middle half of many calls, because interrupts
/// lengthen some.
fn sample(duration: Duration, mut time: impl FnMut() -> Result<f64>) -> Result<Sample> {
    let deadline = Instant::now() + duration;
    let mut calls = Vec::new();
    while calls.len() < 8 || Instant::now() < deadline {
        calls.push(time()?);
    }
    calls.sort_by(f64::total_cmp);
    let middle = &calls[calls.len() / 4..calls.len() - calls.len() / 4];
    Ok(Sample { value: middle.iter().sum::<f64>() / middle.len() as f64, ..Sample::default() })
}

/// A switch with two links that form a loop: a frame that leaves on `OUT` arrives on `IN`.
struct Ring {
    plane: KernelPlane,
    tagged: bool,
    /// Counter of the next frame.
    count: u64,
    frames: u64,
}

const IN: u32 = 1;
const OUT: u32 = 2;
const KEY: [u64; 2] = [7, 11];
const TOPIC: [u8; 32] = [0xd0; 32];
const WRITER: [u8; 32] = [0x50; 32];
const EGRESS: u32 = 5;

impl Ring {
    fn load(object: &Path, role: LinkRole, tagged: bool) -> Result<Self> {
        let mut plane = KernelPlane::load(object, 1024)?;
        plane.set_port(0, LOOPBACK)?;
        plane.set_config(SwitchConfig { own_bit: 1, ethertype: gdp_wire::ETHERTYPE.into(), host_pair: 0 })?;
        let link = LinkEntry { peer_id: IN, rx_keys: [KEY; 2], tx_keys: [KEY; 2], mtu: 1500, ..LinkEntry::default() };
        plane.set_link(&LinkEntry { id: IN, role: role as u32, peer: Name::from_bytes(WRITER), ..link })?;
        plane.set_link(&LinkEntry { id: OUT, role: LinkRole::Switch as u32, reach: 1 << EGRESS, ..link })?;
        let entry = FibEntry { egress_bits: 1 << EGRESS, writer_link: IN, ..FibEntry::default() };
        plane.set_route(&Name::from_bytes(TOPIC), entry)?;
        let mut next_hops = [0; 64];
        next_hops[EGRESS as usize] = OUT;
        plane.set_next_hops(&next_hops)?;
        let count = 1;
        plane.link_memory().set_count(OUT, count);
        Ok(Self { plane, tagged, count, frames: 0 })
    }

    fn time(&mut self) -> Result<f64> {
        let frame = Frame {
            hop_limit: 255,
            link_id: IN,
            link_counter: self.count,
            key: KEY,
            tag: (!self.tagged).then_some(0),
            egress_bits: 1 << EGRESS,
            destination: TOPIC,
            source: WRITER,
            payload: vec![0x5a; 64],
            ..Frame::default()
        };
        let nanoseconds = self.plane.programs.time(Buffers::One, &frame.bytes(), RUNS)?;
        self.count += u64::from(RUNS);
        self.frames += u64::from(RUNS);
        Ok(nanoseconds.into())
    }

    /// Fails unless every frame took the path under measurement.
    fn check(&self) -> Result<()> {
        let counted = self.plane.counters()?;
        let forwarded = counted[Counter::Forwarded as usize];
        let others = counted.iter().sum::<u64>() - forwarded;
        ensure!(forwarded == self.frames && others == 0, "{} frames, counted {counted:?}", self.frames);
        Ok(())
    }
}

/// A program that only redirects.
struct Bare {
    programs: Programs,
    _out: DevMap<aya::maps::MapData>,
}

impl Bare {
    fn load(object: &Path) -> Result<Self> {
        let mut programs = Programs::load(object, &["bare"])?;
        let mut out: DevMap<_> = programs.map("OUT")?;
        out.set(0, LOOPBACK, None, 0)?;
        Ok(Self { programs, _out: out })
    }

    fn time(&mut self) -> Result<f64> {
        let frame = Frame { payload: vec![0x5a; 64], ..Frame::default() }.bytes();
        let mut options = TestRunOptions::new();
        options.data_in = Some(&frame);
        options.repeat = RUNS;
        let result = self.programs.program("bare")?.test_run(options)?;
        const XDP_REDIRECT: u32 = 4;
        ensure!(result.return_value == XDP_REDIRECT, "the bare redirect returned {}", result.return_value);
        Ok(result.duration.subsec_nanos().into())
    }
}
