//! `gdp-ctl xdp stats` and `xdp detach`: state of running and ended daemons in the kernel. The
//! commands need no daemon, but need root. They read and remove the pinned files themselves.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use gdp_wire::table::ABI;
use schemars::JsonSchema;
use serde::Serialize;

use super::output::{AlreadyPrinted, table};
use crate::cli::context::Context;
use gdp_dataplane::pins::{self, BPFFS, Found, Pins, PinsError};
use gdp_dataplane::{host_pair, kernel};

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Print the counters of the XDP programs, and the contents of their maps.
    Stats(Options),
    /// Detach the XDP programs that ended daemons left behind, and free their maps.
    ///
    /// In the current network namespace, the command also removes the interfaces that a daemon
    /// created for endpoints on its host. A daemon does all of this itself when it stops.
    Detach(Options),
}

#[derive(Debug, Args)]
pub struct Options {
    /// Only the switch whose name has this prefix.
    #[arg(value_name = "SWITCH")]
    switch: Option<String>,
    /// BPF file system of the daemon.
    #[arg(long, value_name = "PATH", default_value = BPFFS)]
    bpffs: PathBuf,
}

pub fn run(command: &Command, context: &Context) -> anyhow::Result<()> {
    match command {
        Command::Stats(options) => stats(options, context),
        Command::Detach(options) => detach(options, context),
    }
}

fn stats(options: &Options, context: &Context) -> anyhow::Result<()> {
    let switches = options.find()?.iter().map(describe).collect::<anyhow::Result<Vec<_>>>()?;
    let output = StatsOutput { switches };
    context.output.print(&output, || match output.switches.as_slice() {
        [] => {
            let folder = options.bpffs.display();
            vec![format!(
                "nothing of GDP is pinned under {folder} in this mount namespace; `ip netns exec` enters another one"
            )]
        }
        all => all.iter().map(print).collect::<Vec<_>>().join(&String::new()),
    })
}

fn detach(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut output = DetachOutput::default();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    for found in options.find()? {
        match Pins::of(&found) {
            Ok(pins) => {
                pins.remove()?;
                if found.is_of_this_namespace() {
                    runtime.block_on(host_pair::remove(&found.switch))?;
                }
                output.detached.push(found.folder.display().to_string());
            }
            Err(PinsError::InUse(folder)) => output.running.push(folder.display().to_string()),
            Err(error) => return Err(error.into()),
        }
    }
    context.output.print(&output, || match output.detached.as_slice() {
        [] => vec!["nothing to detach".to_owned()],
        folders => folders.iter().map(|folder| format!("detached {folder}")).collect(),
    })?;
    match output.running.as_slice() {
        [] => Ok(()),
        all => {
            Err(AlreadyPrinted(format!("a daemon runs with {}: stop it, which detaches it as well", all.join(", ")))
                .into())
        }
    }
}

impl Options {
    fn find(&self) -> anyhow::Result<Vec<Found>> {
        let found = pins::find(&self.bpffs).context("cannot look for what daemons left")?;
        let wanted = self.switch.as_deref().unwrap_or_default();
        // Pins contain only the first digits of the name.
        Ok(found.into_iter().filter(|f| f.switch.starts_with(wanted) || wanted.starts_with(&f.switch)).collect())
    }
}

/// Output of `gdp-ctl xdp stats`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct StatsOutput {
    switches: Vec<PinnedOutput>,
}

/// Output of `gdp-ctl xdp detach`: folders of pins.
#[derive(Debug, Default, Serialize, JsonSchema)]
pub struct DetachOutput {
    detached: Vec<String>,
    /// Folders whose daemon is running.
    running: Vec<String>,
}

/// State of a daemon in the kernel.
#[derive(Debug, Serialize, JsonSchema)]
struct PinnedOutput {
    /// First digits of the switch's name.
    switch: String,
    /// Inode number of the network namespace.
    namespace: u64,
    /// Version of the maps.
    abi: u32,
    folder: PathBuf,
    programs: Vec<ProgramOutput>,
    /// Whether a daemon runs with these pins.
    daemon: bool,
    /// Present only if the maps have this program's version.
    #[serde(flatten)]
    maps: Option<MapsOutput>,
}

/// An attached XDP program.
#[derive(Debug, Serialize, JsonSchema)]
struct ProgramOutput {
    ifindex: u32,
    /// `xdp-native` or `xdp-generic`.
    mode: &'static str,
}

/// Contents of the maps of a data plane.
#[derive(Debug, Serialize, JsonSchema)]
struct MapsOutput {
    links: usize,
    names: usize,
    /// Frames that an interface did not accept after a redirect, by interface index.
    redirect_lost: BTreeMap<String, u64>,
    /// Frames by counter.
    counters: BTreeMap<String, u64>,
}

fn describe(found: &Found) -> anyhow::Result<PinnedOutput> {
    let programs = found.links().into_iter().map(|(ifindex, mode)| ProgramOutput { ifindex, mode: mode.as_str() });
    // This program cannot interpret maps of another version.
    let maps = (found.abi == ABI).then(|| {
        let stats = kernel::pinned_stats(&found.folder)
            .with_context(|| format!("cannot read the maps in {}", found.folder.display()))?;
        anyhow::Ok(MapsOutput {
            links: stats.links,
            names: stats.names,
            redirect_lost: stats.losses.iter().map(|(ifindex, lost)| (ifindex.to_string(), *lost)).collect(),
            counters: stats.counters.iter().map(|(counter, count)| (counter.as_str().to_owned(), *count)).collect(),
        })
    });
    Ok(PinnedOutput {
        switch: found.switch.clone(),
        namespace: found.namespace,
        abi: found.abi,
        folder: found.folder.clone(),
        programs: programs.collect(),
        daemon: matches!(Pins::of(found), Err(PinsError::InUse(_))),
        maps: maps.transpose()?,
    })
}

fn print(switch: &PinnedOutput) -> Vec<String> {
    let programs: Vec<_> = switch.programs.iter().map(|p| format!("{} ({})", p.ifindex, p.mode)).collect();
    let daemon = if switch.daemon { "running" } else { "none: forwards by what the last one left" };
    let mut lines = vec![
        format!("switch      {}…, network namespace {}", switch.switch, switch.namespace),
        format!("folder      {}", switch.folder.display()),
        format!("daemon      {daemon}"),
        format!("interfaces  {}", programs.join(", ")),
    ];
    let Some(maps) = &switch.maps else {
        lines.push(format!("maps        of version {}, this program reads {ABI}", switch.abi));
        return lines;
    };
    lines.push(format!("holds       {} links, {} names", maps.links, maps.names));
    for (ifindex, lost) in maps.redirect_lost.iter().filter(|(_, lost)| **lost != 0) {
        lines.push(format!("lost        {lost} frames that interface {ifindex} did not take"));
    }
    let counted = maps.counters.iter().filter(|(_, count)| **count != 0);
    lines.extend(table(["frames", "kernel"], &counted.map(|(n, c)| [n.clone(), c.to_string()]).collect::<Vec<_>>()));
    lines
}
