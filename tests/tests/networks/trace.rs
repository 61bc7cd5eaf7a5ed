//! `gdp-ctl trace` shows the switches that frames cross, in real data planes, and the new ones
//! after a path change.

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::ring::Ring;
use gdp_tests::wait::TIMEOUT;
use serde_json::Value;

use crate::traffic::Traffic;

#[test]
fn a_trace_shows_every_switch_on_the_way_and_the_other_way_after_a_cut() -> Result<()> {
    let mut ring = Ring::start(Tools::beside_this_test()?)?;
    let traffic = Traffic::start((&ring.robot, ring.folder_of("robot")), (&ring.cloud, ring.folder_of("cloud")))?;
    traffic.wait_for_more(100, TIMEOUT).with_context(|| ring.report())?;
    let card = ring.folder_of("robot").join("chatter.card");
    let card = card.to_str().context("a path")?.to_owned();

    // Frames take the available path until every link is up.
    ring.wait("the trace to go by s2", |ring| {
        Ok(switches(&ring.ctl(0, &["trace", &card])?)? == named(ring, &[0, 1, 2]))
    })?;
    let trace = ring.ctl(0, &["trace", &card])?;
    let hops = hops(&trace)?;
    let end = &hops[hops.len() - 1]["end"];
    ensure!(end["links"] == 1 && end["beyond"] == serde_json::json!([]), "the cloud, and nobody else: {trace}");
    ensure!(hops[..2].iter().all(|hop| hop["end"].is_null()), "only the last one is an end: {trace}");
    ensure!(hops[1..].iter().all(|hop| hop["rtt_us"].as_u64() > Some(0)), "{trace}");

    // A switch without a writer has no route for the name; every switch has a path to every other.
    let unknown = ring.ctl(3, &["trace", &card]).err().context("s4 knows a way")?;
    ensure!(format!("{unknown:#}").contains("knows no way to"), "{unknown:#}");
    let fourth = ring.switches[3].name.clone();
    ring.wait("a trace to s4 to go by s3", |ring| {
        Ok(switches(&ring.ctl(1, &["trace", &fourth])?)? == named(ring, &[1, 2, 3]))
    })?;

    ring.set_cable(0, false)?;
    ring.wait("the trace to go by s5 and s4", |ring| {
        Ok(switches(&ring.ctl(0, &["trace", &card])?)? == named(ring, &[0, 4, 3, 2]))
    })?;
    let notices = ring.ctl(2, &["status"])?["counters_by_plane"].clone();
    ensure!(notices["notice"]["userspace"].as_u64() > Some(0), "s3's daemon was given probes: {notices}");
    ensure!(notices["slow"]["kernel"].as_u64() > Some(0), "by the kernel: {notices}");
    traffic.nothing_came_twice()?;
    Ok(())
}

fn switches(trace: &Value) -> Result<Vec<String>> {
    Ok(hops(trace)?.iter().map(|hop| hop["switch"].as_str().unwrap_or("nobody").to_owned()).collect())
}

/// Returns the hops of the only path.
fn hops(trace: &Value) -> Result<Vec<Value>> {
    let paths = trace["paths"].as_array().context("no paths")?;
    ensure!(paths.len() == 1, "{trace}");
    Ok(paths[0]["hops"].as_array().context("no hops")?.clone())
}

fn named(ring: &Ring, switches: &[usize]) -> Vec<String> {
    switches.iter().map(|i| ring.switches[*i].name.clone()).collect()
}
