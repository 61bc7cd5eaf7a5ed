//! Measures whether frames to a known name arrive while an authorised endpoint sends to a million
//! names without routes.
//!
//! This is the most expensive such endpoint: its frames have a counter and a tag and are fresh. The
//! switch verifies and looks up each before dropping it. The frames to the known name arrive at a
//! fixed rate, on the same link, interface and core.

use std::cell::RefCell;

use anyhow::Result;
use gdp_tests::measure::figure::{Figure, Measure, Unit};
use gdp_tests::measure::rounds::{Contender, alternate};
use gdp_wire::Counter;

use crate::Bench;
use crate::path::{Kind, Path};
use crate::traffic::{Offered, Traffic};

/// Frames per second to the known name.
const KNOWN: u32 = 100_000;

/// Frames per second to the unknown names.
const FLOODS: [(&str, u32); 3] = [(CALM, 0), ("flood of 0.5 Mpps", 500_000), ("flood of 1 Mpps", 1_000_000)];
const CALM: &str = "no flood";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let path = Path::build(Kind::Xdp, 1, bench)?;
    let traffic = RefCell::new(Traffic::new(path.chain(), path.frames(174), bench)?);
    let unknown = FLOODS.map(|_| RefCell::new(Vec::new()));
    let contenders = FLOODS.iter().zip(&unknown).map(|((series, flood), unknown)| {
        let (traffic, offered) = (&traffic, Offered { known: KNOWN, unknown: *flood });
        Contender::new(series, "to the known name, arrived", move || {
            let run = traffic.borrow_mut().flood(offered, bench.duration())?;
            unknown.borrow_mut().push(run.unknown);
            Ok(run.known)
        })
    });
    let mut measures = alternate(bench.rounds, contenders.collect())?;
    path.check(Some(Counter::NoRoute))?;
    for ((series, _), rounds) in FLOODS.iter().zip(unknown).skip(1) {
        // The first round warms up.
        measures.push(Measure::new(series, "to unknown names, sent", rounds.into_inner().split_off(1)));
    }
    let title = "0.1 Mpps to a known name, beside a flood to a million unknown ones";
    let figure = Figure::new("flood", title, Unit::FramesPerSecond, measures);
    Ok(vec![FLOODS.iter().skip(1).fold(figure, |figure, (series, _)| figure.compare(series, CALM, |_| None))])
}
