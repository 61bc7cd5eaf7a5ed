//! Frames per second through one and three switches, three ways: XDP, the kernel's IPv4 routers, and the userspace plane
//! on packet sockets. Run by `cargo xtask bench forward`; needs root.
//!
//! ```text
//!  robot ── s1 ( ── s2 ── s3 ) ── cloud
//!  generator                      sink       (both XDP, the same for all)
//! ```
//!
//! No daemons: the tables are what a RIB would have installed, put there through the same `Planes`. All paths exist at
//! once and are measured in turn, so that a busy machine slows all of them; a ratio is the median of the rounds' ratios.
//! The generator keeps a number of frames under way and waits for arrivals beyond that, so a rate is one without loss. XDP and
//! the routers run on the generator's core, which is how veths work; the userspace plane's threads take whatever is left.
//! Toward switches the generator counts and tags every frame, as an endpoint must; toward routers it is spared that. So the first
//! hop of XDP pays for a tag more than it computes.
//!
//! Then the FIB alone, with a million names.

mod fib;
mod lookups;
mod path;
mod report;
mod traffic;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use clap::Parser;

use path::{Kind, Path};
use report::{Report, Row};
use traffic::Generator;

/// Payload bytes of the GDP frames; IPv4 packets have the same length as the frames.
const PAYLOADS: [usize; 2] = [64, 1400];

#[derive(Parser)]
struct Options {
    /// The XDP switch
    #[arg(long)]
    ebpf_object: PathBuf,
    /// Generator and sink, `gdp-ebpf-bench`
    #[arg(long)]
    bench_object: PathBuf,
    /// Each path is measured this often, in turn
    #[arg(long, default_value_t = 7)]
    rounds: usize,
    /// How long one measurement takes
    #[arg(long, default_value_t = 300)]
    milliseconds: u64,
    /// One JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// What cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> Result<()> {
    let options = Options::parse();
    gdp_tests::wait::catch_interrupts();
    gdp_tests::netns::sweep()?;
    let mut paths = Vec::new();
    for hops in [1, 3] {
        for kind in [Kind::Xdp, Kind::Ip, Kind::Userspace] {
            let path = Path::build(kind, hops, &options.ebpf_object)?;
            let generator = Generator::new(path.chain(), &path.robot_link(), &options.bench_object)?;
            paths.push((path, generator));
        }
    }
    let duration = Duration::from_millis(options.milliseconds);
    let mut rows: Vec<Row> = Vec::new();
    for payload in PAYLOADS {
        let first = rows.len();
        rows.extend(paths.iter().map(|(path, _)| Row::new(path.kind(), path.hops(), payload)));
        for round in 0..=options.rounds {
            for ((path, generator), row) in paths.iter_mut().zip(&mut rows[first..]) {
                let rate = generator.measure(&path.frame(payload), duration)?;
                // The first round warms caches and neighbour tables up.
                if round > 0 {
                    row.add(rate);
                }
            }
        }
    }
    for (path, _) in &paths {
        path.check()?;
    }
    let report = Report::new(rows, fib::measure(&options.bench_object, options.rounds)?);
    if options.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{report}");
    }
    Ok(())
}
