//! `gdp-ctl status`: the daemon's report of its own state, or that of a switch to which the user's
//! key attaches.

use anyhow::bail;
use clap::Args;
use gdp_proto::admin::links::Counts;
use gdp_proto::admin::proxy::ProxyReply;
use gdp_proto::admin::status::{RecentRefusal, StatusReply, TierStatus, Warning};
use gdp_proto::control::{AttachmentStatus, Inspected, Inspection};
use gdp_util::date::relative;
use gdp_util::unix_time::unix_seconds;
use schemars::JsonSchema;
use serde::Serialize;

use super::output::{short, table};
use super::proxy_status;
use crate::cli::context::Context;
use crate::cli::node::NodeOptions;
use crate::client::ProgramStatus;
use crate::ros::fabric::Fabric;

/// Show the state of the switch.
///
/// Without --switch, the daemon of this machine reports everything, or its proxy if there is no
/// daemon. With --switch, a machine
/// without a daemon asks the switch to which its key attaches. That switch shows itself, and of the
/// links and names only those of this key.
#[derive(Debug, Args)]
pub struct Options {
    /// Show the state of this machine's proxy. The default where only a proxy runs.
    #[arg(long, conflicts_with = "switch")]
    proxy: bool,
    #[command(flatten)]
    node: NodeOptions,
}

/// Output of `gdp-ctl status`: of this machine's daemon or proxy, or of a switch elsewhere.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum StatusOutput {
    Daemon(Box<StatusReply>),
    Attachment(Box<AttachmentStatus>),
    Proxy(Box<ProxyReply>),
}

impl From<ProgramStatus> for StatusOutput {
    fn from(status: ProgramStatus) -> Self {
        match status {
            ProgramStatus::Switch(status) => Self::Daemon(status),
            ProgramStatus::Proxy(status) => Self::Proxy(status),
        }
    }
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let is_proxy = options.proxy || (!options.node.names_switch() && context.has_only_proxy());
    let output = match options.node.asks_elsewhere(context) {
        _ if is_proxy => context.proxy(context.socket.as_deref())?.status()?.into(),
        true => {
            let by_node = async |fabric: &Fabric| match fabric.node.inspect(Inspection::Status).await? {
                Inspected::Status(status) => Ok(status),
                _ => bail!("the switch answered another question"),
            };
            StatusOutput::Attachment(options.node.with_fabric(options.node.keyring()?, context, by_node)?)
        }
        false => context.client()?.status()?.into(),
    };
    context.output.print(&output, || match &output {
        StatusOutput::Daemon(status) => describe(status),
        StatusOutput::Attachment(status) => describe_attachment(status),
        StatusOutput::Proxy(status) => proxy_status::describe(status),
    })
}

fn describe_attachment(status: &AttachmentStatus) -> Vec<String> {
    let mut lines = vec![
        format!("switch      {}", status.switch),
        format!("release     {}", status.release),
        format!("domain      {}", status.domain.map_or_else(|| "none".into(), |domain| domain.to_string())),
        format!("data plane  {}", status.data_plane),
        match &status.no_rib {
            None => "RIB         reached".into(),
            Some(reason) => format!("RIB         not reached: {}", reason),
        },
    ];
    let now = unix_seconds();
    let links = status.links.iter().map(|link| {
        let until = link.admitted_until.map_or_else(|| "-".into(), |until| relative(until, now));
        let (lane, address) = (link.lane.to_string(), link.address.clone());
        [lane, address, link.mtu.to_string(), format!("{} µs", link.rtt_us), until]
    });
    lines.extend(section(["link", "from", "MTU", "RTT", "until"], &links.collect::<Vec<_>>()));
    let yes = |is: bool| if is { "yes" } else { "" }.to_owned();
    let names = status.names.iter();
    let names = names.map(|of| [format!("{:#}", of.name), yes(of.sends), yes(of.receives), yes(of.has_receivers)]);
    lines.extend(section(["name", "sends", "receives", "has receivers"], &names.collect::<Vec<_>>()));
    lines.extend(status.truncated.then(|| "…".into()));
    lines
}

fn describe(status: &StatusReply) -> Vec<String> {
    let mut lines = vec![
        format!("switch      {}", status.name),
        format!("data plane  {}: {}", status.data_plane, status.data_plane_reason),
    ];
    let control = &status.control;
    lines.push(match (&status.rib, &control.reason) {
        (Some(rib), _) => format!("RIB         here: {} names, {} switches", rib.names, rib.switches),
        (_, None) => format!("RIB         at {}, through {}", short(&control.rib), short(&control.next)),
        (_, Some(reason)) => format!("RIB         not reached: {reason}"),
    });
    if control.fenced > 0 {
        lines.push(format!("            {} pushes refused of a RIB whose term was over", control.fenced));
    }
    lines.extend(status.tiers.iter().flatten().map(describe_tier));
    lines.push(format!("FIB         {} names, generation {}", status.fib.names, status.fib.generation));
    let links = status.links.iter().map(|link| {
        [
            format!("{:#}", link.peer),
            link.role.to_string(),
            link.via.clone(),
            link.address.clone(),
            link.mtu.to_string(),
            format!("{} µs", link.rtt_us),
        ]
    });
    lines.push(String::new());
    lines.extend(table(["link to", "role", "via", "address", "MTU", "RTT"], &links.collect::<Vec<_>>()));
    let in_grace = &status.links_in_grace;
    lines.extend(in_grace.iter().map(|link| format!("holding an earlier link of {} {:#}", link.role, link.peer)));
    let refused = status.links.iter().map(|link| (&link.peer, &link.errors_received));
    for (peer, errors) in refused.chain(in_grace.iter().map(|link| (&link.peer, &link.errors_received))) {
        let line = |(code, count)| format!("{peer:#} refused frames of this switch: {count} × {code}");
        lines.extend(errors.iter().map(line));
    }
    if !status.refused.is_empty() {
        let row = |it: &RecentRefusal| {
            [format!("{:#}", it.peer), it.what.to_string(), format!("× {}", it.count), it.reason.clone()]
        };
        let rows: Vec<_> = status.refused.iter().map(row).collect();
        lines.extend(section(["refused in the last minute", "what", "count", "reason"], &rows));
    }
    let handshakes = &status.handshakes;
    if handshakes.challenged + handshakes.refused + handshakes.displaced + handshakes.failed > 0 {
        lines.push(format!(
            "handshakes of peers: {} had to prove an address, {} refused, {} gave way to newer ones, {} failed",
            handshakes.challenged, handshakes.refused, handshakes.displaced, handshakes.failed
        ));
    }
    lines.extend(describe_counters(status));
    let busiest = status.busiest.iter().map(|busy| [format!("{:#}", busy.name), busy.frames.to_string()]);
    lines.extend(section(["busiest names", "frames, about"], &busiest.collect::<Vec<_>>()));
    for interface in status.interfaces.iter().filter(|interface| interface.redirect_lost > 0) {
        let (lost, name) = (interface.redirect_lost, &interface.interface);
        lines.push(format!(
            "{lost} frames lost that {name} did not take; `gdp-ctl doctor --interface {name}` looks for the cause"
        ));
    }
    for interface in &status.interfaces {
        let Some(device) = &interface.device else { continue };
        let lost = [(device.missed, "arrived and were lost in"), (device.failed, "were not sent by")];
        let line = |(count, what)| format!("{count} packets {what} the device of {}", interface.interface);
        lines.extend(lost.into_iter().filter(|(count, _)| *count > 0).map(line));
    }
    lines.extend(status.warnings.iter().map(describe_warning));
    lines.extend(status.errors.iter().map(|error| format!("error: {error}")));
    lines
}

fn describe_tier(tier: &TierStatus) -> String {
    format!(
        "domain      {} {:#}: {}, {} entries in, {} out, {} refused{}",
        tier.kind,
        tier.domain,
        tier.state,
        tier.entries_in,
        tier.entries_out,
        tier.refused.values().sum::<u64>(),
        tier.reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default()
    )
}

/// Returns the nonzero counters, by data plane.
fn describe_counters(status: &StatusReply) -> Vec<String> {
    let has_dpdk = status.counters_by_plane.values().any(|planes| planes.contains_key("dpdk"));
    let first = if has_dpdk { "dpdk" } else { "kernel" };
    let of = |planes: &Counts, plane: &str| planes.get(plane).copied().unwrap_or_default();
    let rows = status.counters_by_plane.iter().filter(|(_, planes)| planes.values().any(|frames| *frames > 0));
    let row = |(name, planes): (&String, &Counts)| {
        [name.clone(), of(planes, first).to_string(), of(planes, "userspace").to_string()]
    };
    section(["frames", first, "userspace"], &rows.map(row).collect::<Vec<_>>())
}

/// Returns a table after an empty line, if it has rows.
fn section<const N: usize>(heading: [&str; N], rows: &[[String; N]]) -> Vec<String> {
    if rows.is_empty() { Vec::new() } else { [vec![String::new()], table(heading, rows)].concat() }
}

fn describe_warning(warning: &Warning) -> String {
    match warning {
        Warning::Silent { entity, names, for_s } => format!(
            "warning: {entity:#} may send to {names} names that somebody takes, and no frame of it has come for \
             {for_s} s"
        ),
        Warning::NotServed { count, names } => format!(
            "warning: {count} names are read or called, and nobody publishes or serves them: {}{}",
            short(names),
            if *count > names.len() { " …" } else { "" }
        ),
        Warning::Open => "warning: this switch is of no domain: every endpoint that reaches it gets a link; \
                          `gdp-ctl up` makes a domain"
            .into(),
        Warning::SmallMtu { interface, mtu, needed } => format!(
            "warning: {interface} has an MTU of {mtu}, and links need {needed}: `ip link set dev {interface} mtu {needed}`"
        ),
    }
}
