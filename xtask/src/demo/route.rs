//! Follows the topic's name through the fabric, from the writer's switch, by each switch's table
//! and the RIB's topology.

use anyhow::{Context, Result, ensure};
use gdp_tests::fabric::Fabric;
use serde_json::Value;

/// A node on the path, and what it does with the message.
pub struct Hop {
    pub node: String,
    pub what: String,
}

/// Returns the path from the robot to the cloud. Fails if the tables lead nowhere or in a circle.
pub fn follow(fabric: &Fabric) -> Result<Vec<Hop>> {
    let rib = fabric.ctl(fabric.switches.len() - 1, &["rib", "dump"])?;
    let mut here = where_is(&rib, fabric, "publisher")?;
    let reader_is_at = where_is(&rib, fabric, "subscriber")?;
    let mut hops = vec![Hop { node: "robot".into(), what: "gdp-proxy: DDS to sealed frames".into() }];
    loop {
        ensure!(hops.len() <= fabric.switches.len(), "the way of {} is a circle", fabric.name);
        let label = format!("s{}", here + 1);
        let fib = fabric.ctl(here, &["fib", "dump"])?;
        let entry = fib["routes"].as_array().into_iter().flatten().find(|route| route["name"] == fabric.name.as_str());
        if here == reader_is_at {
            let entry = entry.with_context(|| format!("{label} does not hold {}", fabric.name))?;
            ensure!(entry["readers"][0].is_string(), "{label} has no local link for {}", fabric.name);
            hops.push(Hop { node: label, what: "finds its own bit, looks the name up: the cloud's link".into() });
            break;
        }
        let (next, how) = match entry {
            Some(entry) => {
                let next = entry["toward"][0].as_str().with_context(|| format!("{label} leads nowhere: {entry}"))?;
                let bits = entry["egress_bits"].as_str().unwrap_or_default();
                (index(fabric, next)?, format!("looks the name up and stamps egress bits {bits}"))
            }
            // Transit switches have no entry per name. The topology of the domain determines where
            // the bits lead.
            None => (step(&rib, fabric, here, reader_is_at)?, "sees bits, knows nothing of the name".into()),
        };
        hops.push(Hop { node: label, what: format!("{how}: to s{}", next + 1) });
        here = next;
    }
    hops.push(Hop { node: "cloud".into(), what: "gdp-proxy: verify, open, DDS".into() });
    Ok(hops)
}

/// Returns the switch of the endpoint with this role in the name.
fn where_is(rib: &Value, fabric: &Fabric, role: &str) -> Result<usize> {
    let mut records = rib["records"].as_array().into_iter().flatten();
    let record = records.find(|record| record["name"] == fabric.name.as_str() && record["role"] == role);
    let record = record.with_context(|| format!("the RIB knows no {role} of {}", fabric.name))?;
    index(fabric, record["switch"].as_str().unwrap_or_default())
}

/// Returns the neighbour of `from` on the shortest path to `to`.
fn step(rib: &Value, fabric: &Fabric, from: usize, to: usize) -> Result<usize> {
    let mut towards = vec![None; fabric.switches.len()];
    let mut queue = std::collections::VecDeque::from([to]);
    while let Some(here) = queue.pop_front() {
        for near in neighbours(rib, fabric, here)? {
            if near != to && towards[near].is_none() {
                towards[near] = Some(here);
                queue.push_back(near);
            }
        }
    }
    towards[from].with_context(|| format!("no way from s{} to s{}", from + 1, to + 1))
}

fn neighbours(rib: &Value, fabric: &Fabric, of: usize) -> Result<Vec<usize>> {
    let name = fabric.switches[of].name.as_str();
    let switch = rib["switches"].as_array().into_iter().flatten().find(|switch| switch["switch"] == name);
    let near = switch.into_iter().flat_map(|switch| switch["neighbours"].as_array().into_iter().flatten());
    near.map(|neighbour| index(fabric, neighbour["switch"].as_str().unwrap_or_default())).collect()
}

fn index(fabric: &Fabric, name: &str) -> Result<usize> {
    let found = fabric.switches.iter().position(|switch| switch.name == name);
    found.with_context(|| format!("no switch is called {name}"))
}
