//! Frames per second through one, three and five switches, and the cost of a hop.
//!
//! ```text
//!  robot ── s1 ( ── s2 ── s3 ( ── s4 ── s5 )) ── cloud
//!  generator                                     sink       (both XDP, the same for all)
//! ```
//!
//! The generator works equally for all: it counts and tags its frames even if no switch checks
//! them. A chain without a switch measures the cost of generator and sink. The cost of a hop is the
//! difference of five hops and one, so that cost cancels out.

use anyhow::Result;
use gdp_tests::measure::figure::{Aim, Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, alternate};

use crate::Bench;
use crate::path::{Kind, Path};
use crate::series::{
    BARE, DPDK_PACKET, DPDK_XDP, FORKING, IPV4, SWITCH, TESTPMD_PACKET, TESTPMD_XDP, UNTAGGED, USERSPACE,
};
use crate::traffic::Traffic;

const ALONE: &str = "generator and sink alone";

const KINDS: [(&str, Kind); 6] = [
    (BARE, Kind::Bare),
    (UNTAGGED, Kind::Untagged),
    (SWITCH, Kind::Xdp),
    (FORKING, Kind::Forking),
    (IPV4, Kind::Ip),
    (USERSPACE, Kind::Userspace),
];

/// Measures frames with 64 bytes of payload.
pub fn small_frames(bench: &Bench) -> Result<Vec<Figure>> {
    let measures = measure(bench, &KINDS, &[1, 3, 5], 174)?;
    let hops =
        compare(Figure::new("hops", "Frames of 174 B through switches in a row", Unit::FramesPerSecond, measures));
    let costs = KINDS.iter().filter_map(|(series, _)| {
        let [one, five] = [1, 5].map(|n| hops.measure(series, &hops_text(n)));
        let rounds = one?.rounds.iter().zip(&five?.rounds).map(|(one, five)| (1e9 / five - 1e9 / one) / 4.0);
        Some(Measure::new(series, "a further hop", rounds.collect()))
    });
    let costs = costs.collect();
    let hop = Figure::new("hop", "What a further hop costs a frame of 174 B", Unit::Nanoseconds, costs)
        .compare(UNTAGGED, BARE, |_| None)
        .compare(IPV4, SWITCH, |_| None);
    Ok(vec![hops, hop])
}

/// Measures frames with 1400 bytes of payload.
pub fn large_frames(bench: &Bench) -> Result<Vec<Figure>> {
    let measures = measure(bench, &KINDS, &[1, 3], 1510)?;
    let title = "Frames of 1510 B through switches in a row";
    Ok(vec![compare(Figure::new("large", title, Unit::FramesPerSecond, measures))])
}

/// Measures one DPDK switch, with the drivers for kernel interfaces.
pub fn dpdk(bench: &Bench) -> Result<Vec<Figure>> {
    let kinds = [
        (SWITCH, Kind::Xdp),
        (DPDK_PACKET, Kind::Dpdk("net_af_packet")),
        (TESTPMD_PACKET, Kind::Testpmd("net_af_packet")),
        (DPDK_XDP, Kind::Dpdk("net_af_xdp")),
        (TESTPMD_XDP, Kind::Testpmd("net_af_xdp")),
    ];
    let measures = measure(bench, &kinds, &[1], 174)?;
    let figure = Figure::new("dpdk-hop", "Frames of 174 B through a switch in DPDK", Unit::FramesPerSecond, measures)
        .compare(DPDK_PACKET, TESTPMD_PACKET, |_| Some(Aim::AtLeast(0.95)))
        .compare(DPDK_XDP, TESTPMD_XDP, |_| Some(Aim::AtLeast(0.95)))
        .compare(DPDK_XDP, SWITCH, |_| None);
    Ok(vec![figure])
}

fn compare(figure: Figure) -> Figure {
    let at_least = |aims: [f64; 3]| {
        move |case: &str| {
            let aim = [1, 3, 5].into_iter().zip(aims).find(|(hops, _)| hops_text(*hops) == case);
            aim.map(|(_, aim)| Aim::AtLeast(aim))
        }
    };
    figure
        .compare(UNTAGGED, BARE, at_least([0.9; 3]))
        .compare(SWITCH, BARE, |_| None)
        .compare(FORKING, SWITCH, |_| None)
        .compare(SWITCH, IPV4, at_least([1.8, 2.2, 2.6]))
        .compare(SWITCH, USERSPACE, at_least([8.0; 3]))
}

fn measure(bench: &Bench, kinds: &[(&'static str, Kind)], hops: &[usize], length: usize) -> Result<Vec<Measure>> {
    let mut paths: Vec<(&str, Path)> = vec![(ALONE, Path::build(Kind::Cable, 0, bench)?)];
    for hops in hops {
        for (series, kind) in kinds {
            paths.push((series, Path::build(*kind, *hops, bench)?));
        }
    }
    let mut contenders = Vec::new();
    for (series, path) in &paths {
        let mut traffic = Traffic::new(path.chain(), path.frames(length), bench)?;
        let case = hops_text(path.chain().switches().len());
        contenders.push(Contender::new(series, case, move || path.while_it_runs(|| traffic.rate(bench.duration()))));
    }
    let measures = alternate(bench.rounds, contenders)?;
    paths.iter().try_for_each(|(_, path)| path.check(None))?;
    Ok(measures)
}

fn hops_text(hops: usize) -> String {
    match hops {
        0 => "no hop".to_owned(),
        1 => "1 hop".to_owned(),
        hops => format!("{hops} hops"),
    }
}
