//! The cost of a copy, compared with a frame to one reader through the same switch. Readers are
//! behind one interface each, or all behind one.
//!
//! ```text
//!                            ┌ p1 ──── w1  reader
//!  generator  w0 ── p0 switch┼ …
//!                            └ p64 ─── w64 reader
//! ```

use std::cell::RefCell;

use anyhow::{Result, ensure};
use gdp_dataplane::PlaneConfig;
use gdp_tests::frames::Frame;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_wire::{Counter, LinkEntry, Name};

use crate::Bench;
use crate::star::{Leaf, OWN_BIT, Star, Switch, WRITER, far_port, xdp};
use crate::traffic::{Frames, Sink, Spread, Traffic};

const COPIES: [usize; 3] = [2, 8, 64];
const MOST: usize = COPIES[COPIES.len() - 1];

/// Frames in flight to one interface with several readers. The switch makes all copies of a batch
/// before the veth delivers any. They must fit a veth's ring of 256.
const ONE_RING: u64 = 128;

const COPY: &str = "a copy";
const SINGLE: &str = "a frame to one reader";
const ALONE: &str = "generator alone";
const COPY_ALONE: &str = "a copy, without generator";
const SINGLE_ALONE: &str = "one reader, without generator";

/// A name and its readers.
struct Topic {
    series: &'static str,
    case: String,
    readers: Vec<Leaf>,
    spread: Spread,
}

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let star = Star::build(1 + MOST, 1500)?;
    let topics = topics();
    let links: Vec<Leaf> = [WRITER].into_iter().chain(apart(MOST)).chain(together(MOST)).collect();
    let mut switch = star.start(PlaneConfig { count_losses: false, ..xdp(bench.ebpf_object.clone()) }, &links)?;
    for (i, topic) in topics.iter().enumerate() {
        switch.set_route(name(i), OWN_BIT, &topic.readers)?;
    }
    let traffic = RefCell::new(traffic(&star, bench)?);
    let mut contenders = Vec::new();
    for (i, Topic { series, case, spread, .. }) in topics.iter().enumerate() {
        let traffic = &traffic;
        contenders.push(Contender::new(series, case, move || {
            let mut traffic = traffic.borrow_mut();
            traffic.change(frame(name(i)), *spread);
            cost(&mut traffic, bench)
        }));
    }
    let mut measures = alternate(bench.rounds, contenders)?;
    check(&switch)?;
    measures.extend(without_generator(&measures, &topics));

    let title = "A copy of a frame of 174 B, by readers of the frame";
    let mut figure = Figure::new("replication", title, Unit::Nanoseconds, measures);
    for (series, over) in [(COPY, SINGLE), (COPY_ALONE, SINGLE_ALONE)] {
        figure = figure.compare_with(series, (over, ONE), |_| Some(Aim::AtMost(1.0)));
    }
    Ok(vec![figure])
}

const ONE: &str = "1 reader";

fn topics() -> Vec<Topic> {
    let single = Topic { series: SINGLE, case: ONE.to_owned(), readers: apart(1), spread: Spread::SINGLE };
    let discarding = Spread { discard: true, ..Spread::SINGLE };
    let alone = Topic { series: ALONE, case: "nothing is sent".to_owned(), readers: apart(1), spread: discarding };
    let topic = |readers: Vec<Leaf>, place: &str, window| {
        let copies = readers.len() as u64;
        Topic {
            series: COPY,
            case: format!("{copies} readers, {place}"),
            readers,
            spread: Spread { copies, window, discard: false },
        }
    };
    let apart = COPIES.map(|n| topic(apart(n), "an interface each", Spread::SINGLE.window));
    let together = COPIES.map(|n| topic(together(n), "one interface", ONE_RING));
    [alone, single].into_iter().chain(apart).chain(together).collect()
}

/// Returns readers behind one interface each.
fn apart(count: usize) -> Vec<Leaf> {
    (1..=count).map(|i| Leaf { index: 1 + i as u32, interface: i, reach: 0 }).collect()
}

/// Returns other readers, all behind the first interface that is not the writer's.
fn together(count: usize) -> Vec<Leaf> {
    (1..=count).map(|i| Leaf { index: (1 + MOST + i) as u32, interface: 1, reach: 0 }).collect()
}

/// Connects the writer to sinks at all readers.
fn traffic(star: &Star, bench: &Bench) -> Result<Traffic> {
    let mut sink = Sink::attach(&star.far, &far_port(1), bench)?;
    (2..=MOST).try_for_each(|i| sink.attach_to(&star.far, &far_port(i)))?;
    let link =
        LinkEntry { id: WRITER.id(), peer_id: WRITER.id(), tx_keys: [WRITER.rx_key(); 2], ..LinkEntry::default() };
    let frames = Frames {
        frame: frame(name(0)),
        header_at: gdp_tests::packet::ETHERNET,
        link,
        tagged: true,
        spread: Spread::SINGLE,
    };
    Traffic::from(&star.far, &far_port(WRITER.interface), sink, frames)
}

fn frame(destination: Name) -> Vec<u8> {
    let frame = Frame {
        link_id: WRITER.id(),
        destination: destination.to_bytes(),
        source: WRITER.name().to_bytes(),
        payload: vec![0x5a; 64],
        ..Frame::default()
    };
    frame.bytes()
}

fn name(topic: usize) -> Name {
    Name::from_bytes([0xd0 + topic as u8; 32])
}

/// Returns nanoseconds per frame that arrives.
fn cost(traffic: &mut Traffic, bench: &Bench) -> Result<Sample> {
    let sample = traffic.rate(bench.duration())?;
    Ok(Sample { value: 1e9 / sample.value, ..sample })
}

/// Subtracts the generator's cost: the rest is the switch and the arrival.
fn without_generator(measures: &[Measure], topics: &[Topic]) -> Vec<Measure> {
    let Some(alone) = measures.iter().find(|measure| measure.series == ALONE) else { return Vec::new() };
    let of = |topic: &Topic| {
        let all = measures.iter().find(|measure| measure.series == topic.series && measure.case == topic.case)?;
        if topic.series == ALONE {
            return None;
        }
        let rounds = all.rounds.iter().zip(&alone.rounds).map(|(all, alone)| all - alone / topic.spread.copies as f64);
        let series = if topic.series == SINGLE { SINGLE_ALONE } else { COPY_ALONE };
        Some(Measure::new(series, topic.case.clone(), rounds.collect()))
    };
    topics.iter().filter_map(of).collect()
}

/// Fails unless the kernel made all copies and dropped none.
fn check(switch: &Switch) -> Result<()> {
    let [replicated, delivered] = [Counter::Replicated, Counter::Delivered].map(|counter| switch.count(counter));
    let (replicated, delivered) = (replicated?, delivered?);
    let mut others = switch.planes().counters()?.into_iter();
    let dropped = others.any(|(counter, kernel, userspace)| counter.is_drop() && kernel + userspace > 0);
    let in_kernel = replicated.0 > 0 && delivered.0 > 2 * replicated.0 && replicated.1 + delivered.1 == 0;
    ensure!(in_kernel && !dropped, "{:?}", switch.counted()?);
    Ok(())
}
