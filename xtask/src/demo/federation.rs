//! The paper's Figure 4: a robot at an enterprise and a cloud at a university, two trust domains
//! below a third, both behind NAT. While messages flow, the robot moves to the university. There
//! its switch fails, and another takes over.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use gdp_tests::federation::{Federation, Site};
use gdp_tests::packet::gdp_data_in_udp;
use gdp_tests::peers::{self, Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::wait;
use serde::Serialize;
use serde_json::Value;

use super::story::{Latency, Seen, Story, arrived, text};
use crate::demo::options::{Options, TEXT};
use crate::workspace::{self, Profile};

/// The output of `--json`.
#[derive(Serialize)]
pub struct FederationOutcome {
    sent: u64,
    received: u64,
    lost: u64,
    latency_us: Latency,
    /// The name of the topic, 64 hex digits.
    name: String,
    /// The chapters of the story, in order.
    chapters: Vec<Chapter>,
    #[serde(flatten)]
    seen: Seen,
}

/// A part of the story, from one event to the next.
#[derive(Serialize)]
struct Chapter {
    what: &'static str,
    /// The robot's address in its network. `seen_as` is the address that its switch sees.
    robot_address: String,
    seen_as: String,
    /// The switches from the robot to the cloud, in order.
    path: Vec<String>,
    /// The longest latency of a message from the robot to the cloud, in milliseconds. It shows the
    /// cost of the event.
    gap_ms: f64,
}

const FIGURE: &str = "
                     ╔═ tier 1 ═╗
                     ║  b3 RIB  ║
                     ╚══╪════╪══╝
  ╔═ enterprise ════════╪═╗╔═╪═ university ══════════════╗
  ║             RIB b1 ─┘ ║║ └─ b2 RIB ──────────────────╫── NAT ── cloud
  ║                  │    ║║    ├────┐                   ║          Fast DDS listener
  ║                 a1    ║║   u1   u2                   ║
  ╚══════════════════╪════╝╚════╪════╪═══════════════════╝
                    NAT        NAT ──┘
                     └┄┄┄ robot ┄┄┄┘     Cyclone DDS talker
";

pub fn play(options: &Options, story: &Story) -> Result<FederationOutcome> {
    story.say("Building the paper's Figure 4 in network namespaces, each switch with XDP:");
    story.say(FIGURE);
    let mut federation = Federation::start(workspace::tools(Profile::Release))?;
    federation.start_proxies()?;
    let name = federation.name.clone().context("the name of the topic")?;
    story.name(&name);
    story.say(
        "\nThe robot is a member of the enterprise, which lets it visit the university; the tier above lets \
               both cross it.",
    );
    story.say("Talker and listener know of nothing but DDS; what is behind NAT dials out.");

    let traffic = Traffic {
        count: ((options.seconds as f64) * options.rate).ceil() as u64,
        rate: options.rate,
        size: options.size,
        text: TEXT.into(),
        depth: 100,
        on_loopback: true,
        ..Default::default()
    };
    let talks = Side { at: &federation.robot, vendor: Vendor::Cyclone, traffic: &traffic };
    let hears = Side { at: &federation.cloud, vendor: Vendor::FastDds, traffic: &traffic };
    let mut conversation = Conversation::start(&federation.tools, talks, hears, federation.folder())
        .with_context(|| federation.report())?;
    let air = federation.on_the_air()?;
    conversation.open()?;
    let is_data = |frame: &[u8]| gdp_data_in_udp(frame).is_some();
    let frame = air.receive(Duration::from_secs(10), is_data).context("between the robot and the NAT")?;
    let part = Duration::from_secs(options.seconds) / 3;
    let mut chapters = Vec::new();
    let mut watch = |federation: &Federation, what, before, at, conversation: &mut Conversation| {
        chapters.push(chapter(federation, story, what, before, at, part, conversation)?);
        Ok::<_, anyhow::Error>(())
    };
    watch(&federation, "The robot is at the enterprise", 0, "a1", &mut conversation)?;
    let before = received(&conversation);
    federation.roam(Site::University)?;
    let at = serving(&federation)?;
    watch(&federation, "The robot has moved to the university", before, at, &mut conversation)?;
    let (before, at) = (received(&conversation), serving(&federation)?);
    federation.kill(at)?;
    let other = if at == "u1" { "u2" } else { "u1" };
    watch(&federation, "Its switch has died, and another has taken over", before, other, &mut conversation)?;

    let received = conversation.finish(Duration::from_secs(5), Duration::from_secs(10))?;
    let count = arrived(&received);
    let outcome = FederationOutcome {
        sent: traffic.count,
        received: count,
        lost: traffic.count - count,
        latency_us: Latency::of(&received),
        name,
        chapters,
        seen: Seen::look(&frame),
    };
    story.result(outcome.sent, outcome.received, &outcome.latency_us);
    let start = gdp_data_in_udp(&frame).context("a data frame")?;
    story.capture("in the air between the robot and the NAT", &outcome.seen, &frame, start);
    Ok(outcome)
}

fn received(conversation: &Conversation) -> usize {
    peers::received(&conversation.listener).len()
}

/// Prints messages for a while, and then what the switches report. `before` is the number of
/// messages at the start of the chapter. `at` is the robot's switch.
fn chapter(
    federation: &Federation,
    story: &Story,
    what: &'static str,
    before: usize,
    at: &str,
    length: Duration,
    conversation: &mut Conversation,
) -> Result<Chapter> {
    let begun = Instant::now();
    story.say(&format!("\n{what}: {}", federation.robot_address()));
    let (mut next, mut told) = (Duration::ZERO, None);
    while begun.elapsed() < length {
        wait::check_interrupt()?;
        conversation.listener.check_alive()?;
        conversation.talker.check_alive()?;
        let messages = peers::received(&conversation.listener);
        if begun.elapsed() >= next
            && messages.len() > before
            && let Some(latest) = messages.last()
        {
            story.message(latest);
            next = begun.elapsed() + Duration::from_secs(1);
        }
        // The switches' state has settled by now.
        if told.is_none() && begun.elapsed() >= length / 2 {
            told = Some((seen_as(federation, at)?, path(federation, at)?));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let (seen_as, path) = told.context("nothing was told")?;
    let messages = peers::received(&conversation.listener);
    let slowest = messages[before..].iter().map(|message: &Received| message.latency).max().unwrap_or_default();
    let gap_ms = slowest.as_secs_f64() * 1000.0;
    story.say(&format!("  {at} sees it as {seen_as}; its messages go {}", path.join(" → ")));
    story.say(&format!("  the longest that one of {} took: {gap_ms:.0} ms", messages.len() - before));
    let robot_address = federation.robot_address().to_owned();
    Ok(Chapter { what, robot_address, seen_as, path, gap_ms })
}

/// Returns the university's switch that carries the robot's messages.
fn serving(federation: &Federation) -> Result<&'static str> {
    let forwarded = |label: &str| -> Result<u64> {
        let status = federation.ctl(label, &["status"])?;
        Ok(status["counters_by_plane"]["forwarded"]["kernel"].as_u64().unwrap_or(0))
    };
    wait::wait_for("the robot's messages at the university", wait::TIMEOUT, || {
        let before = [forwarded("u1")?, forwarded("u2")?];
        std::thread::sleep(Duration::from_millis(200));
        let more = [forwarded("u1")? - before[0], forwarded("u2")? - before[1]];
        Ok(match more {
            [0, 0] => None,
            [first, second] => Some(if first >= second { "u1" } else { "u2" }),
        })
    })
}

/// Returns the source address of the robot's frames, as its switch sees it.
fn seen_as(federation: &Federation, at: &str) -> Result<String> {
    let links = federation.ctl(at, &["link", "list"])?;
    let of_robot = links["links"].as_array().into_iter().flatten().find(|link| link["role"] == "endpoint");
    Ok(text(&of_robot.with_context(|| format!("{at} has no link of the robot"))?["address"]))
}

/// Returns the switches that `gdp-ctl trace` finds from here on. It traces to the border of each
/// domain, and continues at the switch behind it.
fn path(federation: &Federation, from: &str) -> Result<Vec<String>> {
    let name = federation.name.as_deref().context("the name of the topic")?;
    let (mut path, mut at) = (Vec::<String>::new(), from.to_owned());
    loop {
        let trace = match federation.ctl(&at, &["trace", name]) {
            Ok(trace) => trace,
            // The last switch has the reader's link and no further hop.
            Err(_) => {
                path.push(at);
                return Ok(path);
            }
        };
        let hops = trace["paths"][0]["hops"].as_array().cloned().unwrap_or_default();
        let label = |hop: &Value| federation.label_of(hop["switch"].as_str().unwrap_or_default()).unwrap_or("?");
        path.extend(hops.iter().map(|hop| label(hop).to_owned()));
        let beyond = hops.last().and_then(|hop| hop["end"]["beyond"][0]["switch"].as_str().map(str::to_owned));
        match beyond.and_then(|switch| federation.label_of(&switch)) {
            Some(next) if !path.iter().any(|label| label == next) => at = next.to_owned(),
            _ => return Ok(path),
        }
    }
}
