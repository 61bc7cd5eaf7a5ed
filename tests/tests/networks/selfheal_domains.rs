//! Borders of three domains, each with the RIB of its own beside it and that of tier 1 among them,
//! are killed and started again in a random order under traffic from one domain to another, at
//! times two at once. Nothing outlives them here: after each, messages flow anew.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp::{PublishOptions, SubscribeOptions};
use gdp_tests::Tools;
use gdp_tests::federation::{CLOUD_LINK, Federation, ROBOT_LINKS};
use gdp_tests::wait::wait_for;
use gdp_wire::Name;

use crate::flows::{Flow, Topic};
use crate::roaming::party;
use crate::selfheal::Random;

/// Of the order; another one finds other things.
const SEED: u64 = 20261122;

/// How often each border is killed.
const TURNS: usize = 2;

/// The borders with the links that the domains meet by, both ends of each.
const BORDERS: [&str; 3] = ["b1", "b2", "b3"];
const CROSSINGS: [(&str, &str); 2] = [("b1", "b3"), ("b2", "b3")];

/// How soon messages flow again: neighbours miss a silent border, make their links anew, and three
/// RIBs hear of each other.
const RECOVERY: Duration = Duration::from_secs(90);

/// Between two messages of a topic, and their bytes.
const PERIOD: Duration = Duration::from_millis(10);
const SIZE: usize = 200;

#[test]
fn domains_find_each_other_when_borders_and_their_ribs_are_killed_in_any_order() -> Result<()> {
    println!("seed {SEED}");
    let mut federation = Federation::start(Tools::beside_this_test()?)?;
    // Its switch lives on, and so can it always send.
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

/// Waits until each flow has got on.
fn flow_on(what: &str, federation: &Federation, flows: &[(&str, Flow)]) -> Result<()> {
    for (kind, flow) in flows {
        let so_far = flow.heard();
        wait_for(&format!("{kind} messages"), RECOVERY, || Ok((flow.heard() >= so_far + 100).then_some(())))
            .with_context(|| format!("{what}\n{}", federation.report()))?;
    }
    Ok(())
}

/// Waits until borders that live have no link to one that was killed.
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
