//! The border switches of three domains are killed and restarted in a random order under
//! inter-domain traffic, sometimes two at once. Each domain has its RIB next to its border; tier
//! 1's border is among them. No kernel state survives here: after each restart, messages flow
//! again.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp::unstable::{PublishOptions, SubscribeOptions};
use gdp_tests::Tools;
use gdp_tests::federation::{CLOUD_LINK, Federation, ROBOT_LINKS};
use gdp_tests::wait::wait_for;
use gdp_wire::Name;

use crate::flows::{Flow, Topic};
use crate::roaming::party;
use crate::selfheal::Random;

/// Seed of the order; another seed may find other faults.
const SEED: u64 = 20261122;

/// Number of kills of each border.
const TURNS: usize = 2;

/// The borders, and both ends of each link between domains.
const BORDERS: [&str; 3] = ["b1", "b2", "b3"];
const CROSSINGS: [(&str, &str); 2] = [("b1", "b3"), ("b2", "b3")];

/// Longest time until messages flow again. Neighbours notice a silent border, reconnect, and three
/// RIBs exchange updates.
const RECOVERY: Duration = Duration::from_secs(90);

/// Interval between two messages of a topic, and their bytes.
const PERIOD: Duration = Duration::from_millis(10);
const SIZE: usize = 200;

#[test]
fn domains_find_each_other_when_borders_and_their_ribs_are_killed_in_any_order() -> Result<()> {
    println!("seed {SEED}");
    let mut federation = Federation::start(Tools::beside_this_test()?)?;
    // The robot's switch stays alive, so the robot can always send.
    let robot = party(&federation, "robot", &federation.robot, &ROBOT_LINKS[..1])?;
    let cloud = party(&federation, "cloud", &federation.cloud, &[CLOUD_LINK])?;
    let scope: [Result<Name, _>; 2] =
        [&federation.domains.enterprise, &federation.domains.university].map(|name| name.parse());
    let [enterprise, university] = scope;
    let scope = [enterprise?, university?];
    let open = |out, taken| Topic::open(&robot, &cloud, &scope, out, taken).with_context(|| federation.report());
    let topics = [
        ("reliable", open(PublishOptions::reliable(), SubscribeOptions::reliable())?),
        ("best effort", open(PublishOptions::best_effort(), SubscribeOptions::best_effort())?),
    ];
    let flows: Vec<_> = topics.into_iter().map(|(what, topic)| (what, Flow::start(topic, SIZE, PERIOD))).collect();
    flow_on("at the start", &federation, &flows)?;
    let mut random = Random(SEED);
    for turn in 0..TURNS {
        let mut order = BORDERS.to_vec();
        random.shuffle(&mut order);
        while let Some(first) = order.pop() {
            let mut victims = vec![first];
            victims.extend(order.pop_if(|_| random.coin()));
            let noticed = random.coin();
            let what = format!("turn {turn}: {victims:?} killed, noticed: {noticed}");
            victims.iter().try_for_each(|label| federation.kill(label))?;
            if noticed {
                wait_until_missed(&federation, &victims).with_context(|| what.clone())?;
            }
            random.shuffle(&mut victims);
            victims.iter().try_for_each(|label| federation.start_again(label))?;
            let started = Instant::now();
            flow_on(&what, &federation, &flows)?;
            println!("{what}: messages flow {:?} after the start", started.elapsed());
        }
    }
    for (what, flow) in flows {
        let heard = flow.finish().with_context(|| federation.report())?;
        let sequences: Vec<u64> = heard.messages.iter().map(|(sequence, _)| *sequence).collect();
        ensure!(sequences.is_sorted_by(|a, b| a < b), "{what}: twice, or out of order");
        println!("{what}: {} of {} came", sequences.len(), heard.sent);
    }
    Ok(())
}

/// Waits until each flow has received more messages.
fn flow_on(what: &str, federation: &Federation, flows: &[(&str, Flow)]) -> Result<()> {
    for (kind, flow) in flows {
        let so_far = flow.heard();
        wait_for(&format!("{kind} messages"), RECOVERY, || Ok((flow.heard() >= so_far + 100).then_some(())))
            .with_context(|| format!("{what}\n{}", federation.report()))?;
    }
    Ok(())
}

/// Waits until live borders have no link to a killed one.
fn wait_until_missed(federation: &Federation, killed: &[&str]) -> Result<()> {
    let both_ways = CROSSINGS.iter().flat_map(|(a, b)| [(*a, *b), (*b, *a)]);
    for (at, of) in both_ways.filter(|(at, of)| !killed.contains(at) && killed.contains(of)) {
        let gone = federation.switch(of)?.name.clone();
        federation.wait(&format!("{at} to miss {of}"), |it| {
            let links = it.ctl(at, &["link", "list"])?["links"].clone();
            Ok(links.as_array().context("links")?.iter().all(|link| link["peer"] != *gone))
        })?;
    }
    Ok(())
}
