//! `cargo xtask demo --chain`: sends a ROS 2 topic of one DDS vendor across three XDP switches to
//! the other vendor's listener.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::packet::{ETHERNET, is_gdp_data};
use gdp_tests::peers::{self, Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::wait;
use serde::Serialize;
use serde_json::Value;

use super::route::{self, Hop};
use super::story::{Latency, Seen, Story, text};
use crate::demo::options::{Options, TEXT};
use crate::workspace::{self, Profile};

/// The output of `--json`.
#[derive(Serialize)]
pub struct ChainOutcome {
    sent: u64,
    received: u64,
    lost: u64,
    latency_us: Latency,
    /// The name of the topic, 64 hex digits.
    name: String,
    /// The nodes that a message crosses, in order.
    path: Vec<String>,
    /// Number of data frames that each switch forwarded in the kernel.
    forwarded_in_kernel: BTreeMap<String, u64>,
    /// The data plane of all switches, as their daemons report it, or `mixed` if they differ.
    data_plane: String,
    #[serde(flatten)]
    seen: Seen,
}

/// The link between s1 and s2, which goes through a bridge with an eavesdropper.
const TAPPED: usize = 1;

pub fn play(options: &Options, story: &Story) -> Result<ChainOutcome> {
    story.say("Building   robot ── s1 ──(wire)── s2 ── s3 ── cloud   in network namespaces: Ethernet only, no IP");
    let chain = ChainOptions { wire: Some(TAPPED), ..Default::default() };
    let mut fabric = Fabric::start(workspace::tools(Profile::Release), FabricOptions { chain, ..Default::default() })?;
    fabric.start_proxies()?;
    story.name(&fabric.name);

    let traffic = Traffic {
        count: ((options.seconds as f64) * options.rate).ceil() as u64,
        rate: options.rate,
        size: options.size,
        text: TEXT.into(),
        ..Default::default()
    };
    story.say("\nTalker: Cyclone DDS in `robot`. Listener: Fast DDS in `cloud`. Neither knows of anything but DDS.\n");
    let talks = Side { at: fabric.chain.robot(), vendor: Vendor::Cyclone, traffic: &traffic };
    let hears = Side { at: fabric.chain.cloud(), vendor: Vendor::FastDds, traffic: &traffic };
    let mut conversation = Conversation::start(&fabric.tools, talks, hears, fabric.folder())?;
    let before = in_kernel(&fabric)?;
    let eavesdropper = fabric.chain.wire_from_robot()?;
    conversation.open()?;
    let frame = eavesdropper.receive(Duration::from_secs(10), is_gdp_data).context("on the wire between s1 and s2")?;
    let received = watch(&mut conversation, Duration::from_secs(options.seconds), story)?;
    let after = in_kernel(&fabric)?;
    let statuses = (0..fabric.switches.len()).map(|i| fabric.status(i)).collect::<Result<Vec<_>>>()?;

    let route = route::follow(&fabric)?;
    let forwarded = before.iter().zip(&after).map(|(before, after)| after - before).collect::<Vec<_>>();
    let outcome = outcome(&fabric, &traffic, &received, &frame, &route, &forwarded, &statuses);
    tell_route(story, &route);
    tell_counters(story, &outcome, &statuses);
    story.result(outcome.sent, outcome.received, &outcome.latency_us);
    story.capture("on the wire between s1 and s2", &outcome.seen, &frame, ETHERNET);
    Ok(outcome)
}

/// Prints messages while they arrive, and returns all of them.
fn watch(conversation: &mut Conversation, sending: Duration, story: &Story) -> Result<Vec<Received>> {
    let started = Instant::now();
    let mut next = Duration::ZERO;
    while started.elapsed() < sending {
        wait::check_interrupt()?;
        conversation.listener.check_alive()?;
        conversation.talker.check_alive()?;
        if started.elapsed() >= next
            && let Some(latest) = peers::received(&conversation.listener).last()
        {
            story.message(latest);
            next = started.elapsed() + Duration::from_secs(1);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    conversation.finish(Duration::from_secs(5), Duration::from_secs(5))
}

/// Returns the number of data frames that each switch forwarded without its daemon.
fn in_kernel(fabric: &Fabric) -> Result<Vec<u64>> {
    (0..fabric.switches.len()).map(|i| fabric.forwarded_in_kernel(i)).collect()
}

fn outcome(
    fabric: &Fabric,
    traffic: &Traffic,
    received: &[Received],
    frame: &[u8],
    route: &[Hop],
    forwarded: &[u64],
    statuses: &[Value],
) -> ChainOutcome {
    let arrived = super::story::arrived(received);
    let label = |i: usize| format!("s{}", i + 1);
    let planes: Vec<String> = statuses.iter().map(|status| text(&status["data_plane"])).collect();
    ChainOutcome {
        sent: traffic.count,
        received: arrived,
        lost: traffic.count - arrived,
        latency_us: Latency::of(received),
        name: fabric.name.clone(),
        path: route.iter().map(|hop| hop.node.clone()).collect(),
        forwarded_in_kernel: forwarded.iter().enumerate().map(|(i, frames)| (label(i), *frames)).collect(),
        data_plane: match planes.as_slice() {
            [first, rest @ ..] if rest.iter().all(|plane| plane == first) => first.clone(),
            _ => "mixed".into(),
        },
        seen: Seen::look(frame),
    }
}

fn tell_route(story: &Story, route: &[Hop]) {
    story.say("\nRoute, as the switches' tables have it:");
    for hop in route {
        story.say(&format!("  {:<6} {}", hop.node, hop.what));
    }
}

fn tell_counters(story: &Story, outcome: &ChainOutcome, after: &[Value]) {
    story.say("\nData frames forwarded in the kernel, and all that each switch counted since it started:");
    for ((label, frames), status) in outcome.forwarded_in_kernel.iter().zip(after) {
        let counters = status["counters"].as_object().into_iter().flatten();
        let nonzero = counters.filter(|(_, value)| value.as_u64().is_some_and(|n| n > 0));
        let all: Vec<String> = nonzero.map(|(name, value)| format!("{name} {value}")).collect();
        story.say(&format!("  {label}  {:<10} {frames:>8} frames   ({})", text(&status["data_plane"]), all.join(", ")));
    }
}
