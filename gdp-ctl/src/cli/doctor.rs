//! `gdp-ctl doctor`: checks by [`gdp_daemon::doctor`] of the environment for a daemon. Needs no
//! daemon, and changes nothing.

use std::path::PathBuf;

use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;

use super::output::AlreadyPrinted;
use crate::cli::context::Context;
use gdp_daemon::config::Config;
use gdp_daemon::doctor;
use gdp_daemon::doctor::{Finding, Level};

#[derive(Debug, Args)]
pub struct Options {
    /// Configuration file of the daemon (YAML).
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Interface to check instead of the configured ones; may be repeated.
    #[arg(long, value_name = "DEV")]
    interface: Vec<String>,
    /// eBPF object file to check instead of the configured or installed one.
    #[arg(long, value_name = "FILE")]
    ebpf_object: Option<PathBuf>,
}

/// Output of `gdp-ctl doctor`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct DoctorOutput {
    /// No check has failed.
    ok: bool,
    findings: Vec<Finding>,
}

pub fn run(options: Options, context: &Context) -> anyhow::Result<()> {
    let mut config = match &options.config {
        Some(path) => Config::load(path)?,
        None => Config::embedded()?,
    };
    if let Some(socket) = &context.socket {
        config.socket = socket.clone();
    }
    if !options.interface.is_empty() {
        config.interfaces = Some(options.interface);
    }
    config.ebpf_object = options.ebpf_object.or(config.ebpf_object);
    let findings = doctor::examine(&doctor::gather::facts(&config));
    let failed = findings.iter().filter(|finding| finding.level == Level::Failed).count();
    let output = DoctorOutput { ok: failed == 0, findings };
    context.output.print(&output, || output.findings.iter().flat_map(lines).collect::<Vec<_>>())?;
    match failed {
        0 => Ok(()),
        _ => Err(AlreadyPrinted(format!("{failed} of {} checks failed", output.findings.len())).into()),
    }
}

fn lines(finding: &Finding) -> Vec<String> {
    let subject = match &finding.interface {
        Some(interface) => format!("{interface}: {}", finding.check),
        None => finding.check.to_owned(),
    };
    let fact = format!("{:8} {subject}: {}", finding.level.as_str(), finding.fact);
    let remedy = finding.remedy.as_ref().map(|remedy| format!("         → {remedy}"));
    std::iter::once(fact).chain(remedy).collect()
}
