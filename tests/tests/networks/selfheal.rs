//! The daemons of a ring, including the RIB's, are killed and restarted in a random order under
//! traffic, sometimes two at once. Their kernel state continues to forward, and in the end the
//! whole state is as before.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use gdp_tests::Tools;
use gdp_tests::ring::{CLOUD_AT, RIB_AT, ROBOT_AT, Ring};
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::Value;

use crate::traffic::Traffic;

const SWITCHES: usize = 5;

/// Seed of the order; another seed may find other faults.
const SEED: u64 = 20261121;

/// Number of kills of every daemon.
const TURNS: usize = 2;

/// Longest time until the state is as before: nodes notice a silent switch and reconnect.
const RECOVERY: Duration = Duration::from_secs(60);

#[test]
fn all_is_as_it_was_when_daemons_are_killed_and_started_again_in_any_order() -> Result<()> {
    let mut ring = Ring::start(Tools::beside_this_test()?)?;
    let traffic = Traffic::start((&ring.robot, ring.folder_of("robot")), (&ring.cloud, ring.folder_of("cloud")))?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    ring.wait("two records", |ring| Ok(names(ring)?.len() == 2))?;
    let mut before = State::of(&ring)?;
    wait_for("the switches to settle", TIMEOUT, || {
        let earlier = std::mem::replace(&mut before, State::of(&ring)?);
        Ok((earlier == before).then_some(()))
    })?;
    let mut random = Random(SEED);
    for turn in 0..TURNS {
        let mut order: Vec<usize> = (0..SWITCHES).collect();
        random.shuffle(&mut order);
        while let Some(first) = order.pop() {
            let mut victims = vec![first];
            victims.extend(order.pop_if(|_| random.coin()));
            let noticed = random.coin();
            let (what, lost) = (format!("turn {turn}: {victims:?} killed, noticed: {noticed}"), lost(&traffic)?);
            let ends = [ROBOT_AT, CLOUD_AT].iter().filter(|end| victims.contains(end)).count() as u64;
            let links = traffic.links_made() + ends;
            for i in &victims {
                ring.switches[*i].process.kill()?;
            }
            if noticed {
                wait_until_missed(&ring, &victims).with_context(|| format!("{what}\n{}", ring.report()))?;
            }
            random.shuffle(&mut victims);
            for i in &victims {
                ring.start_again(*i)?;
            }
            let started = Instant::now();
            wait_for("all to be as it was", RECOVERY, || {
                let anew = traffic.links_made() >= links && traffic.links_down() == 0;
                Ok((anew && State::of(&ring).is_ok_and(|now| now == before)).then_some(()))
            })
            .with_context(|| {
                let (now, traffic) = (State::of(&ring), traffic.summary());
                format!("{what}\nbefore {before:#?}\nnow {now:#?}\n{traffic}\n{}", ring.report())
            })?;
            let whole = started.elapsed();
            traffic.wait_for_more(500, TIMEOUT).with_context(|| format!("{what}\n{}", ring.report()))?;
            let lost = self::lost(&traffic)? - lost;
            println!("{what}: whole {whole:?} after the start; {lost} messages lost, one each 1 ms");
        }
    }
    let sent = traffic.stop_sending();
    let lost = traffic.nothing_came_twice()? as u64;
    traffic.wait_for_total(sent - lost, TIMEOUT).with_context(|| traffic.summary())?;
    println!("{lost} of {sent} messages lost in all");
    Ok(())
}

/// The state of daemons and kernels.
#[derive(Debug, PartialEq)]
struct State {
    /// The RIB's records: name, role, entity, switch.
    names: Vec<[Value; 4]>,
    /// Egress of each name, per switch.
    fibs: Vec<BTreeMap<String, Value>>,
    /// Peers with links, per switch.
    links: Vec<Vec<String>>,
}

impl State {
    fn of(ring: &Ring) -> Result<Self> {
        let names = names(ring)?;
        let fibs = (0..SWITCHES).map(|i| fib(ring, i)).collect::<Result<_>>()?;
        let links = (0..SWITCHES).map(|i| links(ring, i)).collect::<Result<_>>()?;
        Ok(Self { names, fibs, links })
    }
}

fn names(ring: &Ring) -> Result<Vec<[Value; 4]>> {
    let dump = ring.ctl(RIB_AT, &["rib", "dump"])?;
    let records = dump["records"].as_array().context("records")?;
    Ok(records.iter().map(|record| ["name", "role", "entity", "switch"].map(|field| record[field].clone())).collect())
}

fn fib(ring: &Ring, i: usize) -> Result<BTreeMap<String, Value>> {
    let dump = ring.ctl(i, &["fib", "dump"])?;
    let route = |route: &Value| {
        let mut shown = route.clone();
        // The group's number is internal to the daemon.
        shown["group"] = (route["group"] != 0).into();
        Some((route["name"].as_str()?.to_owned(), shown))
    };
    Ok(dump["routes"].as_array().context("routes")?.iter().filter_map(route).collect())
}

fn links(ring: &Ring, i: usize) -> Result<Vec<String>> {
    let links = ring.ctl(i, &["link", "list"])?["links"].clone();
    let peers = links.as_array().context("links")?.iter().filter_map(|link| link["peer"].as_str());
    let mut peers: Vec<_> = peers.map(str::to_owned).collect();
    peers.sort();
    Ok(peers)
}

/// Waits until live neighbours have no link to a killed daemon.
fn wait_until_missed(ring: &Ring, killed: &[usize]) -> Result<()> {
    wait_for("neighbours to miss who was killed", RECOVERY, || {
        for i in (0..SWITCHES).filter(|i| !killed.contains(i)) {
            let peers = links(ring, i)?;
            if killed.iter().any(|gone| peers.contains(&ring.switches[*gone].name)) {
                return Ok(None);
            }
        }
        Ok(Some(()))
    })
}

/// Returns the number of messages that have not arrived so far. Fails if one arrived twice.
fn lost(traffic: &Traffic) -> Result<usize> {
    traffic.nothing_came_twice().with_context(|| traffic.summary())
}

/// A generator with the same numbers in every run.
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 33) as usize % bound
    }

    pub fn coin(&mut self) -> bool {
        self.below(2) == 0
    }

    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}
