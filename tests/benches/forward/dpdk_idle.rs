//! Processor time of an idle DPDK loop, by its longest sleep: the cost of an idle switch on a
//! robot.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use gdp_dataplane::dpdk::LoopReader;
use gdp_dataplane::forwarder::Shared;
use gdp_dataplane::link_memory::LinkMemory;
use gdp_dataplane::tables::UserTables;
use gdp_dpdk::{Eal, EalConfig, Idle, Switch, SwitchConfig};
use gdp_link::port::interface_index;
use gdp_tests::measure::figure::{Figure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_tests::netns::Namespace;

use crate::Bench;

/// A device without arrivals.
const DEVICE: &str = "net_null8,no-rx=1";
const HOST: &str = "gdp0";

/// Time until a loop sleeps for its full interval.
const SETTLED: Duration = Duration::from_millis(20);

const NOTHING: &str = "nothing arrives";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let namespace = Namespace::create("idle")?;
    let _inside = namespace.enter()?;
    let sleeps = [
        ("idle_us: 0, asks on", Idle::Busy),
        ("idle_us: 50", Idle::Sleep(Duration::from_micros(50))),
        ("idle_us: 250, the default", Idle::default()),
        ("idle_us: 1000", Idle::Sleep(Duration::from_millis(1))),
        ("idle_us: 10000", Idle::Sleep(Duration::from_millis(10))),
    ];
    let duration = bench.duration();
    let contenders =
        sleeps.into_iter().map(|(series, idle)| Contender::new(series, NOTHING, move || taken(idle, duration)));
    let measures = alternate(bench.rounds, contenders.collect())?;
    let title = "Processor time that a loop of DPDK takes in a second";
    Ok(vec![Figure::new("dpdk-idle", title, Unit::Milliseconds, measures)])
}

/// Returns milliseconds of processor time per second.
fn taken(idle: Idle, duration: Duration) -> Result<Sample> {
    let tables = UserTables::new(LinkMemory::new(), 1)?;
    let shared = Arc::new(Shared::new(tables.queues().clone()));
    let config = SwitchConfig { idle, ports: 1, ..SwitchConfig::default() };
    let eal = Eal::begin(&EalConfig::default())?;
    let mut switch = Switch::start(eal, &config, || LoopReader::new(tables.reader(), shared.clone()))?;
    switch.add_port(DEVICE, (HOST, 1500), interface_index)?;
    std::thread::sleep(SETTLED);
    let time = || switch.processor_time().into_iter().sum::<Duration>();
    let (start, before) = (Instant::now(), time());
    std::thread::sleep(duration);
    let value = 1e3 * (time() - before).as_secs_f64() / start.elapsed().as_secs_f64();
    Ok(Sample { value, ..Sample::default() })
}
