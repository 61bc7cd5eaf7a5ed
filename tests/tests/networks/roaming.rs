//! A robot moves from one network to another, its switch there dies, and it moves back. Its topics
//! in both directions, and the programs at both ends, see a gap and no other effect.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp::unstable::{LinkState, PublishOptions, SubscribeOptions};
use gdp_core::domain::{CredentialFiles, Credentials};
use gdp_core::identity::{Identity, SigningKey};
use gdp_tests::Tools;
use gdp_tests::fabric::{TOPIC, TYPE};
use gdp_tests::federation::{CLOUD_LINK, Federation, ROBOT_LINKS, Site};
use gdp_tests::netns::Namespace;
use gdp_tests::packet::gdp_data_in_udp;
use gdp_tests::peers::{self, Conversation, Side, Traffic, Vendor};
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::Name;

use crate::flows::{Flow, Heard, Party, Topic};

/// Interval between two messages of a topic, and their bytes.
const PERIOD: Duration = Duration::from_millis(10);
const SIZE: usize = 200;

#[test]
fn a_robot_roams_between_domains_and_back_and_nothing_reliable_is_lost() -> Result<()> {
    let mut federation = Federation::start(Tools::beside_this_test()?)?;
    let robot = party(&federation, "robot", &federation.robot, &ROBOT_LINKS)?;
    let cloud = party(&federation, "cloud", &federation.cloud, &[CLOUD_LINK])?;
    let scope = [&federation.domains.enterprise, &federation.domains.university];
    let scope = scope.map(|name| name.parse::<Name>());
    let [enterprise, university] = scope;
    let scope = [enterprise?, university?];
    let (every, newest) = (PublishOptions::reliable(), PublishOptions::best_effort());
    let open = |from, to, out, taken| Topic::open(from, to, &scope, out, taken).with_context(|| federation.report());
    let topics = [
        ("robot to cloud, reliable", open(&robot, &cloud, every, SubscribeOptions::reliable())?),
        ("cloud to robot, reliable", open(&cloud, &robot, every, SubscribeOptions::reliable())?),
        ("robot to cloud, best effort", open(&robot, &cloud, newest, SubscribeOptions::best_effort())?),
        ("cloud to robot, best effort", open(&cloud, &robot, newest, SubscribeOptions::best_effort())?),
    ];
    let flows: Vec<_> = topics.into_iter().map(|(what, topic)| (what, Flow::start(topic, SIZE, PERIOD))).collect();
    flow_on(&federation, &flows)?;

    let gaps = |what: &str, since: Instant| {
        flows.iter().for_each(|(flow, heard)| eprintln!("{what}: {flow}: {:?}", heard.gap_since(since)));
    };
    let left = Instant::now();
    federation.roam(Site::University)?;
    eprintln!("moving took {:?}", left.elapsed());
    flow_on(&federation, &flows)?;
    gaps("to the university", left);
    robot.wait_for_links(|links| links[1].main && links[2].state == LinkState::Up)?;

    let died = Instant::now();
    federation.kill("u1")?;
    robot.wait_for_links(|links| links[2].main).with_context(|| federation.report())?;
    flow_on(&federation, &flows)?;
    gaps("to the second switch", died);

    let left = Instant::now();
    federation.roam(Site::Enterprise)?;
    flow_on(&federation, &flows)?;
    gaps("home", left);
    robot.wait_for_links(|links| links[0].main)?;

    for (what, flow) in flows {
        let Heard { messages, counters, sent, .. } = flow.finish().with_context(|| federation.report())?;
        let sequences: Vec<u64> = messages.iter().map(|(sequence, _)| *sequence).collect();
        ensure!(sequences.is_sorted_by(|a, b| a < b), "{what}: twice, or out of order");
        eprintln!("{what}: {} of {sent}; {counters:?}", sequences.len());
        if what.ends_with("reliable") {
            ensure!(sequences.iter().copied().eq(1..=sent), "{what}: {} of {sent} came: {counters:?}", sequences.len());
        }
    }
    Ok(())
}

/// ROS programs see only a delay, once per move.
#[test]
fn ros_programs_on_a_robot_that_roams_notice_a_gap_and_nothing_else() -> Result<()> {
    let mut federation = Federation::start(Tools::beside_this_test()?)?;
    federation.start_proxies()?;
    let traffic = Traffic { count: 600, rate: 50.0, depth: 100, on_loopback: true, ..Default::default() };
    let talks = Side { at: &federation.robot, vendor: Vendor::Cyclone, traffic: &traffic };
    let hears = Side { at: &federation.cloud, vendor: Vendor::FastDds, traffic: &traffic };
    let mut both = Conversation::start(&federation.tools, talks, hears, federation.folder())
        .with_context(|| federation.report())?;
    let air = federation.on_the_air()?;
    both.open()?;
    let frame = air.receive(TIMEOUT, |frame| gdp_data_in_udp(frame).is_some())?;
    for word in [TOPIC, TYPE, &traffic.text, "chatter", "String", "hello"] {
        let seen = frame.windows(word.len()).any(|window| window.eq_ignore_ascii_case(word.as_bytes()));
        ensure!(!seen, "{word} can be read in the air");
    }
    let heard = |federation: &Federation, both: &Conversation| {
        let so_far = peers::received(&both.listener).len();
        let enough = || Ok((peers::received(&both.listener).len() >= so_far + 100).then_some(()));
        wait_for("messages", TIMEOUT, enough).with_context(|| federation.report())
    };
    heard(&federation, &both)?;
    for site in [Site::University, Site::Enterprise] {
        federation.roam(site)?;
        heard(&federation, &both)?;
    }
    let messages = both.finish(TIMEOUT, TIMEOUT).with_context(|| federation.report())?;
    ensure!(messages.iter().all(|message| message.intact));
    let sequences: Vec<i64> = messages.iter().map(|message| message.sequence).collect();
    ensure!(sequences.iter().copied().eq(0..600), "each once and in order: {sequences:?}");
    let slowest = messages.iter().map(|message| message.latency).max();
    eprintln!("the longest that a message took: {slowest:?}");
    Ok(())
}

/// Waits until each flow has received more messages.
fn flow_on(federation: &Federation, flows: &[(&str, Flow)]) -> Result<()> {
    for (what, flow) in flows {
        let so_far = flow.heard();
        let waited = wait_for(what, TIMEOUT, || Ok((flow.heard() >= so_far + 100).then_some(())));
        waited.with_context(|| federation.report())?;
    }
    Ok(())
}

pub fn party(federation: &Federation, label: &str, at: &Namespace, links: &[&str]) -> Result<Party> {
    federation.admit(label)?;
    let folder = federation.folder_of(label);
    let visit = folder.join("visit.peer");
    let files = CredentialFiles {
        card: folder.join("domain.card"),
        membership: folder.join("membership"),
        peers: if visit.exists() { vec![visit] } else { Vec::new() },
    };
    let papers: Credentials = files.load()?;
    let identity = Identity::new(SigningKey::load(&folder.join("key.pem"))?, "proxy");
    Party::connect(at, identity, links, Some(papers)).with_context(|| federation.report())
}
