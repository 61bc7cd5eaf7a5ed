//! The link that carries traffic is cut. The switches of a ring find another path among themselves,
//! without changing any name's routes. Requests to the RIB and its updates find another path as
//! well.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::ring::{CLOUD_AT, RIB_AT, Ring};
use gdp_tests::wait::{TIMEOUT, wait_for};

use crate::traffic::Traffic;

#[test]
fn traffic_flows_again_when_the_active_link_is_cut_and_no_name_is_touched() -> Result<()> {
    let mut ring = Ring::start(Tools::beside_this_test()?)?;
    let traffic = start(&ring)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    ring.wait("it to go by s2 alone", |ring| {
        let (by_s2, by_s4) = (ring.forwarded(1)?, ring.forwarded(3)?);
        traffic.wait_for_more(200, TIMEOUT)?;
        Ok(ring.forwarded(1)? > by_s2 && ring.forwarded(3)? == by_s4)
    })?;
    let told = settled_generations(&ring, 0..5)?;

    ring.set_cable(0, false)?;
    let after = ring.forwarded(3)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    ensure!(ring.forwarded(3)? > after && ring.forwarded(4)? > 0, "it goes by s5 and s4 now");
    let without_a_word = generations(&ring, 0..5)?;
    ensure!(without_a_word == told, "the RIB told switches something: {told:?}, {without_a_word:?}");
    let lost = traffic.nothing_came_twice()?;

    ring.set_cable(0, true)?;
    let before = ring.forwarded(1)?;
    ring.wait("traffic by s2 again", |ring| Ok(ring.forwarded(1)? > before + 100))?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    let lost_on_return = traffic.nothing_came_twice()? - lost;
    for _ in 0..20 {
        ring.set_cable(0, false)?;
        traffic.wait_for_more(20, TIMEOUT).with_context(|| ring.report())?;
        ring.set_cable(0, true)?;
        traffic.wait_for_more(20, TIMEOUT).with_context(|| ring.report())?;
    }
    let lost_by_flapping = traffic.nothing_came_twice()? - lost - lost_on_return;
    let before = ring.forwarded(1)?;
    ring.wait("traffic by s2 again", |ring| Ok(ring.forwarded(1)? > before + 100))?;
    eprintln!(
        "lost {lost} messages, one each 1 ms, when the link was cut, {lost_on_return} when it came back, \
         {lost_by_flapping} when it did so 20 times"
    );
    for i in 0..5 {
        let counters = ring.ctl(i, &["status"])?["counters"].clone();
        ensure!(counters["drop_hop_limit"] == 0, "s{}: a loop: {counters}", i + 1);
    }
    Ok(())
}

/// The daemon of the RIB's switch is gone; its kernel state continues to forward.
#[test]
fn paths_heal_without_the_rib() -> Result<()> {
    let mut ring = Ring::start(Tools::beside_this_test()?)?;
    let traffic = start(&ring)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    let told = settled_generations(&ring, 0..RIB_AT)?;
    ring.switches[RIB_AT].process.kill()?;
    ring.wait("its neighbours to miss it", |ring| {
        let links =
            |i: usize| Ok::<_, anyhow::Error>(ring.ctl(i, &["link", "list"])?["links"].as_array().map_or(0, Vec::len));
        Ok(links(3)? == 1 && links(0)? == 2)
    })?;
    traffic.nothing_is_missing()?;

    ring.set_cable(0, false)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    ensure!(ring.forwarded(3)? > 0, "it goes by s5 and s4 now");
    ensure!(generations(&ring, 0..RIB_AT)? == told);
    traffic.nothing_came_twice()?;
    Ok(())
}

#[test]
fn the_rib_is_reached_round_what_is_cut_or_dead() -> Result<()> {
    let mut ring = Ring::start(Tools::beside_this_test()?)?;
    ring.wait_for_way(CLOUD_AT, 3)?;
    ring.set_cable(2, false)?;
    ring.wait_for_way(CLOUD_AT, 1)?;
    // The cloud subscribes at s3, and the RIB sends s3 its routes.
    let before = ring.generation(CLOUD_AT)?;
    let traffic = start(&ring)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    ensure!(ring.generation(CLOUD_AT)? > before);
    ring.set_cable(2, true)?;
    ring.wait_for_way(CLOUD_AT, 3)?;

    // The daemon on the path dies; its kernel state forwards frames, but nothing else works.
    ring.switches[3].process.kill()?;
    ring.wait_for_way(CLOUD_AT, 1)?;
    let before = ring.generation(CLOUD_AT)?;
    drop(traffic);
    ring.wait("the RIB to take back the cloud's routes", |ring| Ok(ring.generation(CLOUD_AT)? > before))?;
    ring.start_again(3)?;
    ring.wait_for_way(CLOUD_AT, 3)?;

    // Kills the RIB's own daemon. First the others notice the loss; the second restart is
    // immediate, and only the run number reveals it.
    for missed in [true, false] {
        ring.switches[RIB_AT].process.kill()?;
        if missed {
            ring.wait("the RIB to be missed", |ring| {
                let control = ring.ctl(CLOUD_AT, &["status"])?["control"].clone();
                Ok(control["reason"].as_str().is_some_and(|reason| reason.contains("no path")))
            })?;
        }
        ring.start_again(RIB_AT)?;
        ring.wait("the RIB to know all switches again", |ring| {
            Ok(ring.ctl(RIB_AT, &["status"])?["rib"]["switches"] == 5)
        })?;
        ring.wait_for_way(CLOUD_AT, 3)?;
        let traffic = start(&ring)?;
        traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    }
    Ok(())
}

fn start(ring: &Ring) -> Result<Traffic> {
    Traffic::start((&ring.robot, ring.folder_of("robot")), (&ring.cloud, ring.folder_of("cloud")))
}

/// Returns the generations once the RIB has sent all its updates.
fn settled_generations(ring: &Ring, switches: std::ops::Range<usize>) -> Result<Vec<u64>> {
    let mut before = generations(ring, switches.clone())?;
    wait_for("the RIB to have told all", TIMEOUT, || {
        std::thread::sleep(Duration::from_secs(1));
        let now = generations(ring, switches.clone())?;
        Ok((std::mem::replace(&mut before, now.clone()) == now).then_some(now))
    })
}

fn generations(ring: &Ring, switches: std::ops::Range<usize>) -> Result<Vec<u64>> {
    switches.map(|i| ring.generation(i)).collect()
}
