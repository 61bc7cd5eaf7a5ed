//! Signed messages of 64 B per second, directly through `gdp_e2e::seal` on one CPU. One case seals
//! and signs in batches, the other opens and verifies.

use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use gdp_core::crypto::Backend;
use gdp_e2e::seal::{Draft, Encoding, Reader, Received, Segments, Timestamps, Writer};
use gdp_tests::measure::cpu;
use gdp_tests::measure::figure::{Aim, Figure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_wire::Name;

use crate::Bench;
use crate::sealing::{PAYLOAD, pair};

/// The time of all signing and reading.
const UNIX_NS: u64 = 1;

const BODY: [u8; 64] = [0x5a; 64];

/// Messages per signature.
const BATCHES: [usize; 5] = [1, 8, 64, 256, 1024];

/// Aim of the largest batches: signed messages per second.
const ENOUGH: f64 = 300_000.0;

const SEALED: &str = "sealed and signed";
const OPENED: &str = "opened and verified";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    cpu::on(cpu::SENDER, || measure(bench))
}

fn measure(bench: &Bench) -> Result<Vec<Figure>> {
    let mut contenders = Vec::new();
    for batch in BATCHES {
        for (series, what) in [(SEALED, What::Seal), (OPENED, What::Open)] {
            let mut pair = Pair::new(batch)?;
            let measure = move || pair.rate(what, bench.duration());
            contenders.push(Contender::new(series, case(batch), measure));
        }
    }
    let measures = alternate(bench.rounds, contenders)?;
    let figure =
        Figure::new("transport-signing", "Signed messages of 64 B on one CPU", Unit::MessagesPerSecond, measures);
    let largest = case(BATCHES[BATCHES.len() - 1]);
    let figure =
        [SEALED, OPENED].iter().fold(figure, |figure, series| figure.aim(series, &largest, Aim::AtLeast(ENOUGH)));
    Ok(vec![figure])
}

fn case(batch: usize) -> String {
    match batch {
        1 => "each by itself".to_owned(),
        batch => format!("batches of {batch}"),
    }
}

/// The half that is timed.
#[derive(Clone, Copy, PartialEq, Eq)]
enum What {
    Seal,
    Open,
}

struct Pair {
    writer: Writer,
    reader: Reader,
    from: Name,
    batch: usize,
    segments: Segments,
}

impl Pair {
    fn new(batch: usize) -> Result<Self> {
        let (writer, reader, from) = pair(Backend::selected())?;
        Ok(Self { writer, reader, from, batch, segments: Segments::new() })
    }

    /// Returns messages per second of the timed half; the other half runs untimed.
    fn rate(&mut self, what: What, duration: Duration) -> Result<Sample> {
        let messages = vec![Draft::new(Encoding::Bytes, &BODY); self.batch];
        let (mut spent, mut count, mut out) = (Duration::ZERO, 0, Received::default());
        let begun = Instant::now();
        while spent < duration {
            let start = Instant::now();
            self.writer.seal_batch(UNIX_NS, &messages, PAYLOAD, &mut self.segments)?;
            if what == What::Seal {
                spent += start.elapsed();
                count += self.batch;
                continue;
            }
            let start = Instant::now();
            let now = Timestamps { steady_ns: begun.elapsed().as_nanos() as u64, unix_ns: UNIX_NS };
            out.clear();
            for payload in self.segments.iter() {
                let taken = self.reader.push(now, self.from, payload, &mut out);
                ensure!(taken.is_ok(), "{taken:?}");
            }
            spent += start.elapsed();
            let opened = out.messages.len();
            ensure!(opened == self.batch, "{opened} of {} messages were opened", self.batch);
            count += opened;
        }
        Ok(Sample { value: count as f64 / spent.as_secs_f64(), ..Sample::default() })
    }
}
