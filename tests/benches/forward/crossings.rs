//! Frames per second through one XDP switch from links of one kind to links of another. The
//! comparison is with a router that forwards the same GDP frames as IPv4 datagrams.
//!
//! ```text
//!  robot ── Ethernet, or UDP ── s1 ── Ethernet, or UDP ── cloud
//!  generator                                              sink
//! ```

use anyhow::{Context, Result};
use gdp_tests::measure::figure::{Aim, Figure, Unit};
use gdp_tests::measure::rounds::{Contender, alternate};

use crate::Bench;
use crate::path::{Kind, Path};
use crate::series::IPV4;
use crate::switch::Medium::{self, Ethernet, Udp4, Udp6};
use crate::traffic::Traffic;

/// Bytes of a GDP frame.
const FRAME: usize = 96 + 64;

const CROSSINGS: [(&str, [Medium; 2]); 6] = [
    ("UDP/IPv4 to UDP/IPv4", [Udp4, Udp4]),
    ("Ethernet to UDP/IPv4", [Ethernet, Udp4]),
    ("UDP/IPv4 to Ethernet", [Udp4, Ethernet]),
    ("Ethernet to UDP/IPv6", [Ethernet, Udp6]),
    ("UDP/IPv6 to Ethernet", [Udp6, Ethernet]),
    ("Ethernet to Ethernet", [Ethernet, Ethernet]),
];

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let mut paths = vec![(IPV4, Path::build(Kind::Ip, 1, bench)?)];
    for (series, media) in CROSSINGS {
        paths.push((series, Path::crossing(media, bench).context(series)?));
    }
    let mut contenders = Vec::new();
    for (series, path) in &paths {
        let mut traffic = Traffic::new(path.chain(), path.frames(path.around() + FRAME), bench)?;
        contenders.push(Contender::new(series, "1 hop", move || traffic.rate(bench.duration())));
    }
    let measures = alternate(bench.rounds, contenders)?;
    paths.iter().try_for_each(|(series, path)| path.check(None).context(*series))?;
    let title = format!("GDP frames of {FRAME} B from link to link");
    let figure = Figure::new("crossings", title, Unit::FramesPerSecond, measures);
    Ok(vec![CROSSINGS.iter().fold(figure, |figure, (series, media)| {
        let aim = (*media != [Ethernet; 2]).then_some(Aim::AtLeast(1.3));
        figure.compare(series, IPV4, |_| aim)
    })])
}
