//! `cargo xtask fresh`: does on a clean Debian 12 what a new user of this project does.
//!
//! A root with gcc, git and this machine's Rust toolchain gets a clone of `HEAD`. There the verb
//! sets up, builds and starts the switch. Then it runs all of setup twice, looks up every external
//! program, and runs the unit tests. So it detects what a developer's machine has but setup does
//! not install.
//!
//! [`root`] makes the root and runs commands in it. [`source`] clones the tree. [`cache`] stores
//! downloads and compiled files for the next run. [`stages`] measures.

mod cache;
mod root;
pub mod source;
mod stages;

use std::time::Duration;

use anyhow::{Result, bail, ensure};
use gdp_tests::netns::{self, End, Namespace, veth};
use gdp_tests::process::Process;
use gdp_tests::wait;

use self::cache::{Cache, Compiled};
use self::root::Root;
use self::stages::Stages;
use crate::setup::{self, Purpose};
use crate::workspace;

#[derive(clap::Args)]
pub struct Options {
    /// Compile everything, without compiled files of an earlier run. Downloads remain cached
    #[arg(long)]
    cold: bool,
    /// End with this stage
    #[arg(long, value_enum)]
    until: Option<Milestone>,
}

/// A stage that a run may end with.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Milestone {
    /// What `cargo xtask run` needs is installed
    Setup,
    /// The switch runs
    Switch,
}

/// Timeout for building and starting the switch on a busy machine.
const BUILD: Duration = Duration::from_secs(3600);

/// The stages between a clone and a running switch, whose sum README states.
const TO_A_SWITCH: [&str; 4] = ["clone", "crates", "setup run", "run, to the ready line"];

pub fn run(options: Options) -> Result<()> {
    if !workspace::is_root() {
        bail!("a clean root is made with debootstrap, chroot and namespaces, which needs root");
    }
    setup::ensure(Purpose::Fresh)?;
    wait::catch_interrupts();
    netns::sweep()?;
    let mut stages = Stages::default();
    let result = in_a_clean_root(&options, &mut stages);
    stages.print();
    let to_a_switch = stages.sum(&TO_A_SWITCH);
    if let Some(seconds) = to_a_switch {
        println!("from the clone to a running switch, downloads cached: {seconds:.0} s");
    }
    result
}

fn in_a_clean_root(options: &Options, stages: &mut Stages) -> Result<()> {
    let mut cache = Cache::open(&workspace::target().join("fresh"))?;
    let root = stages.time("Debian root", || Root::make(&cache))?;
    stages.time("clone", || source::clone(&root.clone_folder()))?;
    if !options.cold {
        cache.use_compiled(&Compiled::key(&root.clone_folder())?)?;
        source::restore_times(&root.clone_folder(), &cache.times())?;
    }
    stages.time("crates", || {
        root.online(&cache, &["cargo", "fetch", "--locked"])?;
        // Fetches the crates that are built later without a network.
        root.online(&cache, &["cargo", "fetch", "--locked", "--manifest-path", "gdp-ebpf/Cargo.toml"])?;
        root.online(&cache, &["cargo", "fetch", "--manifest-path", "third_party/rustdds/published/Cargo.toml"])
    })?;
    stages.time("setup run", || root.online(&cache, &["cargo", "xtask", "setup", "run"]))?;
    if options.until == Some(Milestone::Setup) {
        return root.remove();
    }
    let site = Site::new()?;
    let native = format!("XDP: native on {INTERFACE}");
    stages.time("run, to the ready line", || run_switch(&root, &cache, &site, &[], &native))?;
    let (named, on) = (["--", "--interface", INTERFACE], format!("links on Ethernet: on {INTERFACE}"));
    stages.time("run, with an interface", || run_switch(&root, &cache, &site, &named, &on))?;
    if options.until == Some(Milestone::Switch) {
        cache.complete()?;
        return root.remove();
    }
    stages.time("setup", || root.online(&cache, &["cargo", "xtask", "setup"]))?;
    stages.time("workloads", || root.online(&cache, &["target/venv-eval/bin/python", "-c", WORKLOADS]))?;
    stages.time("setup again", || {
        let said = root.output(&cache, &["cargo", "xtask", "setup"])?;
        ensure!(said.starts_with("Nothing to do"), "the second setup is not done: {said}");
        Ok(())
    })?;
    stages.time("programs", || root.online(&cache, &["cargo", "xtask", "setup", "--programs"]))?;
    stages.time("unit tests, compile", || {
        root.offline(&cache, &site.host, &["cargo", "xtask", "test", "--unit", "--no-run"])
    })?;
    // The compiled files are good, even if a test fails.
    cache.complete()?;
    stages.time("unit tests", || root.offline(&cache, &site.host, &["cargo", "xtask", "test", "--unit"]))?;
    root.remove()
}

/// Builds and starts the switch as README describes. Waits for its ready line, which must contain
/// `says`, and ends the switch.
fn run_switch(root: &Root, cache: &Cache, site: &Site, options: &[&str], says: &str) -> Result<()> {
    let logs = tempfile::tempdir()?;
    let command = root.command(cache, Some(&site.host), &[&["cargo", "xtask", "run"], options].concat())?;
    let mut switch = Process::spawn("switch", command, logs.path())?;
    let said = |process: &Process| process.stdout() + &process.stderr();
    switch.wait_until("the ready line", BUILD, |switch| {
        said(switch).lines().any(|line| line.contains("ready: switch") && line.contains(says)).then_some(())
    })
}

/// Loads what the workloads of the evaluation load, with the libraries of the system.
const WORKLOADS: &str = "import cv2, cyclonedds.domain, fcl, ompl.base, ompl.geometric, pyorbslam3";

const INTERFACE: &str = "e0";

/// A host with one interface, and the other end of its cable. It keeps `cargo xtask run` away from
/// the interfaces of this machine.
struct Site {
    host: Namespace,
    _beyond: Namespace,
}

impl Site {
    fn new() -> Result<Self> {
        let (host, beyond) = (Namespace::create("fresh")?, Namespace::create("beyond")?);
        host.enable_ipv6()?;
        host.enable_loopback_multicast()?;
        let end = |namespace, interface, last| End { namespace, interface, mac: [2, 0, 0, 0, 0, last] };
        veth(&end(&host, INTERFACE, 1), &end(&beyond, "b0", 2), 1500)?;
        host.ip(&["address", "add", "192.0.2.1/24", "dev", INTERFACE])?;
        Ok(Self { host, _beyond: beyond })
    }
}
