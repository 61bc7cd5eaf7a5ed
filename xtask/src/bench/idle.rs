//! Measures the wake-ups and the processor time of proxies and switches while nothing is published.
//!
//! ```text
//!  talker ─lo─ gdp-proxy ── s1 ── s2 ── s3 ── gdp-proxy ─lo─ listener
//! ```
//!
//! The publishers and subscribers of all topics exist, and are silent. Each program has one or two
//! links. A wake-up is a voluntary context switch of a thread.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::peers::{Conversation, Side, Traffic, Vendor};
use gdp_tests::process::Process;
use gdp_tests::{netns, wait};
use serde::Serialize;

use crate::build::{self, Executables, Features};
use crate::peers as peer_programs;
use crate::setup::{self, Purpose};
use crate::workspace::{self, Profile};

#[derive(clap::Args)]
pub struct Options {
    /// Print one JSON object on stdout instead of a table
    #[arg(long)]
    json: bool,
    /// Duration of each measurement in seconds
    #[arg(long, default_value_t = 30)]
    seconds: u64,
    /// Number of topics; repeat for several. Default: 1 and 20
    #[arg(long = "topics")]
    topics: Vec<u32>,
    /// Measure programs that are built as for the tests: quick to compile, and slower
    #[arg(long)]
    checked: bool,
}

/// The last message to the measurement: links are watched closely for a while after data.
const SETTLE: Duration = Duration::from_secs(25);

/// Time between two messages. No measurement meets a second one.
const PAUSE: Duration = Duration::from_secs(3600);

#[derive(Serialize)]
struct Row {
    topics: u32,
    program: &'static str,
    /// Wake-ups a second, of all threads.
    wakeups: f64,
    /// Percent of one processor.
    cpu_percent: f64,
    /// Wake-ups a second, by the name of the thread.
    threads: BTreeMap<String, f64>,
}

pub fn run(options: Options) -> Result<()> {
    if !workspace::is_root() {
        bail!("network namespaces need root");
    }
    let profile = if options.checked { Profile::Checked } else { Profile::Dist };
    setup::ensure(Purpose::Bench)?;
    build::executables(Executables::All, profile, Features::default())?;
    peer_programs::build_dds()?;
    wait::catch_interrupts();
    netns::sweep()?;
    let mut rows = Vec::new();
    let topics = if options.topics.is_empty() { vec![1, 20] } else { options.topics };
    for topics in topics {
        rows.extend(measure(profile, topics, Duration::from_secs(options.seconds))?);
    }
    if options.json {
        println!("{}", serde_json::json!({ "bench": "idle", "seconds": options.seconds, "rows": rows }));
    } else {
        print_table(&rows);
    }
    Ok(())
}

fn measure(profile: Profile, topics: u32, time: Duration) -> Result<Vec<Row>> {
    let tools = workspace::tools(profile);
    let mut fabric = Fabric::start(tools.clone(), FabricOptions { topics, ..Default::default() })?;
    fabric.start_proxies()?;
    let count = u64::from(topics);
    let traffic = Traffic { count: count + 1, rate: 1.0 / PAUSE.as_secs_f64(), topics, ..Default::default() };
    let side = |at| Side { at, vendor: Vendor::FastDds, traffic: &traffic };
    let ends = [side(fabric.chain.robot()), side(fabric.chain.cloud())];
    let both = Conversation::start(&tools, ends[0], ends[1], fabric.folder())?;
    both.open()?;
    eprintln!("{topics} topics: idle for {SETTLE:?}, then measured for {time:?}");
    wait(SETTLE)?;
    let programs: Vec<(&'static str, &Process)> = [("robot's proxy", &fabric.robot), ("cloud's proxy", &fabric.cloud)]
        .into_iter()
        .filter_map(|(label, process)| Some((label, process.as_ref()?)))
        .chain(["s1", "s2", "s3"].into_iter().zip(fabric.switches.iter().map(|switch| &switch.process)))
        .collect();
    let sample = |process: &Process| Ok((process.wakeups()?, process.cpu()?));
    let before = programs.iter().map(|(_, process)| sample(process)).collect::<Result<Vec<_>>>()?;
    let begun = Instant::now();
    wait(time)?;
    let after = programs.iter().map(|(_, process)| sample(process)).collect::<Result<Vec<_>>>()?;
    let seconds = begun.elapsed().as_secs_f64();
    let rows = programs.iter().zip(before.into_iter().zip(after)).map(|((program, _), (before, after))| {
        let threads: BTreeMap<String, f64> = after
            .0
            .into_iter()
            .map(|(name, count)| {
                let earlier = before.0.get(&name).copied().unwrap_or(0);
                (name, count.saturating_sub(earlier) as f64 / seconds)
            })
            .collect();
        let cpu = after.1.saturating_sub(before.1);
        Row {
            topics,
            program,
            wakeups: threads.values().sum(),
            cpu_percent: 100.0 * cpu.as_secs_f64() / seconds,
            threads,
        }
    });
    Ok(rows.collect())
}

fn wait(time: Duration) -> Result<()> {
    let until = Instant::now() + time;
    while Instant::now() < until {
        std::thread::sleep(Duration::from_millis(100).min(until.saturating_duration_since(Instant::now())));
        wait::check_interrupt()?;
    }
    Ok(())
}

fn print_table(rows: &[Row]) {
    println!("programs while nothing is published");
    println!("{:>6}  {:<14}  {:>10}  {:>12}  threads", "topics", "program", "wake-ups/s", "% of a core");
    for row in rows {
        let Row { topics, program, wakeups, cpu_percent, threads } = row;
        let busy = threads.iter().filter(|(_, count)| **count >= 0.05);
        let threads: Vec<String> = busy.map(|(name, count)| format!("{name} {count:.1}")).collect();
        println!("{topics:>6}  {program:<14}  {wakeups:>10.1}  {cpu_percent:>12.3}  {}", threads.join(", "));
    }
}
