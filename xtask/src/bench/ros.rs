//! Measures ROS 2 messages through two proxies. Compares them with the same DDS programs over
//! kernel routers, and with two zenoh bridges. `paths.rs` has the paths.
//!
//! Both ends are Cyclone DDS. Loads with a high rate use Fast DDS, because its program is compiled.
//! With `--hogs`, busy loops compete with everything for the processors.

use anyhow::Result;
use gdp_tests::chain::ChainOptions;
use gdp_tests::peers::Vendor;

use super::paths::{Bench, BenchRoute, Cables, Cell, LOAD, Load, measure_in_turn, print_table};
use crate::workspace::Profile;

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Duration of each load per path and round, in seconds
    #[arg(long, default_value_t = 10)]
    seconds: u32,
    /// Number of alternating measurements per path
    #[arg(long, default_value_t = 2)]
    rounds: u32,
    /// Message size to measure, in bytes; repeat for several. Default: all sizes
    #[arg(long = "bytes")]
    bytes: Vec<usize>,
    /// Path to measure; repeat for several
    #[arg(long = "path", value_enum, default_values_t = ROUTES)]
    paths: Vec<BenchRoute>,
    /// Number of busy loops beside each measurement
    #[arg(long, default_value_t = 0)]
    hogs: u32,
    /// MTU of all interfaces between the two hosts, in bytes
    #[arg(long, default_value_t = 1500)]
    mtu: u32,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    checked: bool,
}

const ROUTES: [BenchRoute; 7] = [
    BenchRoute::Gdp,
    BenchRoute::GdpUdp,
    BenchRoute::Ip,
    BenchRoute::Local,
    BenchRoute::Tcp,
    BenchRoute::ZenohTls,
    BenchRoute::Zenoh,
];

const LOADS: [Load; 8] = [
    Load { bytes: 64, ..LOAD },
    Load { bytes: 8_000, ..LOAD },
    Load { bytes: 1_000_000, ..LOAD },
    Load { bytes: 6_000_000, ..LOAD },
    // A point cloud with the QoS that ROS drivers use.
    Load { bytes: 6_000_000, rate: 10.0, depth: 5, ..LOAD },
    Load { bytes: 6_000_000, rate: 10.0, depth: 5, vendor: Vendor::FastDds, ..LOAD },
    Load { bytes: 64, rate: 5_000.0, vendor: Vendor::FastDds, ..LOAD },
    Load { bytes: 64, rate: 20_000.0, topics: 20, vendor: Vendor::FastDds, ..LOAD },
];

pub fn run(options: Options) -> Result<()> {
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    let bench = Bench::prepare(&options.paths, profile)?;
    let cables = Cables { chain: ChainOptions { mtu: options.mtu, ..Default::default() }, faults: None };
    let mut rows = Vec::new();
    for load in LOADS.iter().filter(|load| options.bytes.is_empty() || options.bytes.contains(&load.bytes)) {
        let routes: Vec<BenchRoute> =
            options.paths.iter().copied().filter(|route| load.is_carried_by(*route)).collect();
        let name = format!("MTU {}", options.mtu);
        let cell = Cell { name, cables: cables.clone(), hogs: options.hogs, load: *load };
        rows.extend(measure_in_turn(&bench, &cell, &routes, (options.rounds, options.seconds))?);
    }
    if options.json {
        println!("{}", serde_json::json!({ "bench": "ros", "switches": 3, "rows": rows }));
    } else {
        print_table(&rows);
    }
    Ok(())
}
