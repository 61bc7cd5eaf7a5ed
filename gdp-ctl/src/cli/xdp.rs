//! `gdp-ctl xdp stats` and `xdp detach`: what daemons have left in the kernel, running ones or not.
//! Works without a daemon, as root; reads and removes the pinned files itself.

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use clap::{Args, Subcommand};
use gdp_wire::table::ABI;
use serde_json::{Map, Value, json};

use super::output::table;
use crate::cli::context::Context;
use gdp_dataplane::pins::{self, BPFFS, Found, Pins, PinsError};
use gdp_dataplane::{host_pair, kernel};

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Print what the XDP programs count and hold.
    Stats(Options),
    /// Take the XDP programs off and free their maps, where no daemon runs; and in the present
    /// network namespace remove the interfaces that a daemon made for endpoints on its host. A
    /// daemon that is stopped does so itself.
    Detach(Options),
}

#[derive(Debug, Args)]
pub struct Options {
    /// Only the switch whose name begins so.
    #[arg(value_name = "SWITCH")]
    switch: Option<String>,
    /// The daemon's BPF file system.
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
    context.output.print(json!({"switches": switches}), || match switches.as_slice() {
        [] => vec!["nothing of GDP is in the kernel".to_owned()],
        all => all.iter().map(print).collect::<Vec<_>>().join(&String::new()),
    })
}

fn detach(options: &Options, context: &Context) -> anyhow::Result<()> {
    let (mut detached, mut running) = (Vec::new(), Vec::new());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    for found in options.find()? {
        match Pins::of(&found) {
            Ok(pins) => {
                pins.remove()?;
                if found.is_of_this_namespace() {
                    runtime.block_on(host_pair::remove(&found.switch))?;
                }
                detached.push(found.folder.display().to_string());
            }
            Err(PinsError::InUse(folder)) => running.push(folder.display().to_string()),
            Err(error) => return Err(error.into()),
        }
    }
    context.output.print(json!({"detached": detached, "running": running}), || match detached.as_slice() {
        [] => vec!["nothing to detach".to_owned()],
        folders => folders.iter().map(|folder| format!("detached {folder}")).collect(),
    })?;
    if !running.is_empty() {
        bail!("a daemon runs with {}: stop it, which detaches it as well", running.join(", "));
    }
    Ok(())
}

impl Options {
    fn find(&self) -> anyhow::Result<Vec<Found>> {
        let found = pins::find(&self.bpffs).context("cannot look for what daemons left")?;
        let wanted = self.switch.as_deref().unwrap_or_default();
        // Of the name only the first digits are known.
        Ok(found.into_iter().filter(|f| f.switch.starts_with(wanted) || wanted.starts_with(&f.switch)).collect())
    }
}

fn describe(found: &Found) -> anyhow::Result<Value> {
    let programs = found.links().into_iter().map(|(ifindex, mode)| json!({"ifindex": ifindex, "mode": mode.as_str()}));
    let mut value = json!({
        "switch": found.switch,
        "namespace": found.namespace,
        "abi": found.abi,
        "folder": found.folder,
        "programs": programs.collect::<Vec<_>>(),
        "daemon": matches!(Pins::of(found), Err(PinsError::InUse(_))),
    });
    // What the maps of another version mean is not known here.
    if found.abi == ABI {
        let stats = kernel::pinned_stats(&found.folder)
            .with_context(|| format!("cannot read the maps in {}", found.folder.display()))?;
        value["links"] = stats.links.into();
        value["names"] = stats.names.into();
        let counters = stats.counters.iter().map(|(counter, count)| (counter.as_str().to_owned(), (*count).into()));
        let losses = stats.losses.iter().map(|(ifindex, lost)| (ifindex.to_string(), (*lost).into()));
        value["redirect_lost"] = Value::Object(losses.collect::<Map<_, _>>());
        value["counters"] = Value::Object(counters.collect::<Map<_, _>>());
    }
    Ok(value)
}

fn print(switch: &Value) -> Vec<String> {
    let text = |key: &str| switch[key].as_str().unwrap_or_default().to_owned();
    let programs = switch["programs"].as_array().into_iter().flatten();
    let programs: Vec<_> =
        programs.map(|p| format!("{} ({})", p["ifindex"], p["mode"].as_str().unwrap_or_default())).collect();
    let daemon = if switch["daemon"] == true { "running" } else { "none: forwards by what the last one left" };
    let mut lines = vec![
        format!("switch      {}…, network namespace {}", text("switch"), switch["namespace"]),
        format!("folder      {}", text("folder")),
        format!("daemon      {daemon}"),
        format!("interfaces  {}", programs.join(", ")),
    ];
    let Some(counters) = switch["counters"].as_object() else {
        lines.push(format!("maps        of version {}, this program reads {ABI}", switch["abi"]));
        return lines;
    };
    lines.push(format!("holds       {} links, {} names", switch["links"], switch["names"]));
    let lost = switch["redirect_lost"].as_object().into_iter().flatten().filter(|(_, lost)| **lost != 0);
    for (ifindex, lost) in lost {
        lines.push(format!("lost        {lost} frames that interface {ifindex} did not take"));
    }
    let rows: Vec<_> = counters
        .iter()
        .filter(|(_, count)| **count != 0)
        .map(|(name, count)| [name.clone(), count.to_string()])
        .collect();
    lines.extend(table(["frames", "kernel"], &rows));
    lines
}
