//! Measures messages over encrypted paths between two hosts: this fabric's, zenoh's bridges, TLS
//! over TCP, and QUIC. The cables between the hosts vary, and so do busy loops beside the programs.
//!
//! The ends of the first two are DDS programs (Cyclone DDS in Python, or Fast DDS for many topics).
//! The ends of TLS are Python programs, and those of QUIC compiled ones; both have no DDS, so they
//! show what the network itself takes. All ends verify each message. Paths are measured in turn.
//!
//! A message is stamped when the program writes it. A connection whose buffer is full blocks its
//! program, and DDS does not. The timer of the QUIC program has a resolution of 1 ms, so at high
//! rates its messages leave in groups.

use anyhow::Result;
use gdp_faults::Faults;
use gdp_tests::chain::ChainOptions;
use gdp_tests::peers::Vendor;

use super::paths::{Bench, BenchRoute, Cables, Cell, LOAD, Load, measure_in_turn, print_table};
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Measure only the smallest and the largest usual message, on plain cables, for two seconds
    #[arg(long)]
    quick: bool,
    /// Duration of each load per path and round, in seconds
    #[arg(long, default_value_t = 6)]
    seconds: u32,
    /// Number of alternating measurements per path
    #[arg(long, default_value_t = 1)]
    rounds: u32,
    /// Kind of cables to measure; repeat for several. Default: all kinds
    #[arg(long = "cables", value_enum)]
    cables: Vec<CableKind>,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    checked: bool,
}

/// What is special about the cables, or about the hosts.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum CableKind {
    /// MTU 1500 and no transmit offloads, as between machines whose frames XDP forwards
    Plain,
    /// Checksums and segmentation are left to the (virtual) hardware
    Offloads,
    /// MTU 9000
    Jumbo,
    /// 1 Gb/s, with a queue of 4 ms
    Gigabit,
    /// 10 ms round trip
    Delay,
    /// Plain cables, and two busy loops beside the programs
    Hogs,
}

impl CableKind {
    fn name(self) -> &'static str {
        match self {
            Self::Plain | Self::Hogs => "plain",
            Self::Offloads => "offloads",
            Self::Jumbo => "MTU 9000",
            Self::Gigabit => "1 Gb/s",
            Self::Delay => "10 ms",
        }
    }

    fn cables(self) -> Cables {
        let with = |chain| Cables { chain, faults: None };
        match self {
            Self::Plain | Self::Hogs => Cables::default(),
            Self::Offloads => with(ChainOptions { transmit_offloads: true, ..Default::default() }),
            Self::Jumbo => with(ChainOptions { mtu: 9000, ..Default::default() }),
            Self::Gigabit => {
                const QUEUE: u64 = 500_000;
                Cables::with_faults(Faults { rate: Some(1_000_000_000), queue: Some(QUEUE), ..Default::default() })
            }
            Self::Delay => Cables::with_faults(Faults::delay(5_000_000)),
        }
    }

    fn hogs(self) -> u32 {
        if self == Self::Hogs { 2 } else { 0 }
    }
}

/// A load, the cables that it crosses, and the paths that carry it.
struct Case {
    kind: CableKind,
    load: Load,
    routes: &'static [BenchRoute],
}

const SMALL: Load = Load { bytes: 64, ..LOAD };
const LARGE: Load = Load { bytes: 1_000_000, ..LOAD };
const CLOUD: Load = Load { bytes: 6_000_000, rate: 10.0, depth: 5, ..LOAD };

const FEW: &[BenchRoute] = &[BenchRoute::GdpUdp, BenchRoute::ZenohTls, BenchRoute::TcpTls, BenchRoute::Quinn];
const MORE: &[BenchRoute] =
    &[BenchRoute::GdpUdp, BenchRoute::Gdp, BenchRoute::ZenohTls, BenchRoute::TcpTls, BenchRoute::Quinn];
/// Zenoh's transport for low latency does not divide messages, and so carries only small ones.
const ALL: &[BenchRoute] = &[
    BenchRoute::GdpUdp,
    BenchRoute::Gdp,
    BenchRoute::ZenohTls,
    BenchRoute::ZenohTlsLowLatency,
    BenchRoute::TcpTls,
    BenchRoute::Quinn,
    BenchRoute::QuinnStreams,
];

const CASES: [Case; 13] = [
    Case { kind: CableKind::Plain, load: SMALL, routes: ALL },
    Case { kind: CableKind::Plain, load: Load { rate: 1_000.0, ..SMALL }, routes: ALL },
    Case {
        kind: CableKind::Plain,
        load: Load { rate: 20_000.0, topics: 20, vendor: Vendor::FastDds, ..SMALL },
        routes: &[BenchRoute::GdpUdp, BenchRoute::Gdp, BenchRoute::Ip, BenchRoute::Quinn],
    },
    Case { kind: CableKind::Plain, load: Load { bytes: 8_000, ..LOAD }, routes: ALL },
    Case { kind: CableKind::Plain, load: LARGE, routes: MORE },
    Case { kind: CableKind::Plain, load: CLOUD, routes: MORE },
    Case { kind: CableKind::Offloads, load: LARGE, routes: FEW },
    Case { kind: CableKind::Jumbo, load: LARGE, routes: MORE },
    Case { kind: CableKind::Gigabit, load: CLOUD, routes: FEW },
    Case { kind: CableKind::Delay, load: SMALL, routes: FEW },
    Case { kind: CableKind::Delay, load: LARGE, routes: FEW },
    Case { kind: CableKind::Hogs, load: SMALL, routes: FEW },
    Case { kind: CableKind::Hogs, load: LARGE, routes: FEW },
];

pub fn run(options: Options) -> Result<()> {
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    let seconds = if options.quick { 2 } else { options.seconds };
    let is_wanted = |case: &&Case| {
        let quick =
            case.kind == CableKind::Plain && case.load.rate == LOAD.rate && [64, 1_000_000].contains(&case.load.bytes);
        (options.cables.is_empty() || options.cables.contains(&case.kind)) && (quick || !options.quick)
    };
    let cases: Vec<&Case> = CASES.iter().filter(is_wanted).collect();
    let routes: Vec<BenchRoute> = cases.iter().flat_map(|case| case.routes).copied().collect();
    let bench = Bench::prepare(&routes, profile)?;
    let mut rows = Vec::new();
    for Case { kind, load, routes } in cases {
        let cell = Cell { name: kind.name().to_owned(), cables: kind.cables(), hogs: kind.hogs(), load: *load };
        rows.extend(measure_in_turn(&bench, &cell, routes, (options.rounds, seconds))?);
    }
    let cores = std::thread::available_parallelism()?;
    if options.json {
        println!("{}", serde_json::json!({ "bench": "wire", "switches": 3, "cores": cores, "rows": rows }));
    } else {
        println!("{cores} cores");
        print_table(&rows);
    }
    Ok(())
}
