//! A link between switches passes nothing, although both ends have a carrier. Switches leave it
//! within a third of a second, and use it again once it is mended.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_link::link::IDLE_TIMEOUT;
use gdp_tests::Tools;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::ring::Ring;
use gdp_tests::wait::{TIMEOUT, sleep};

use crate::traffic::Traffic;

/// Longest gap when a link with data falls silent, on a loaded machine. QUIC alone takes
/// [`IDLE_TIMEOUT`] and a second.
const LEFT: Duration = Duration::from_secs(1);

/// Frames are a millisecond apart, so those that are missing measure the gap.
#[test]
fn traffic_leaves_a_link_between_switches_that_falls_silent_and_returns() -> Result<()> {
    let mut ring = Ring::start_with_wire(Tools::beside_this_test()?)?;
    let traffic = Traffic::start((&ring.robot, ring.folder_of("robot")), (&ring.cloud, ring.folder_of("cloud")))?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    by_s2(&mut ring)?;
    let before = traffic.nothing_came_twice()?;
    ring.cut_wire(true)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    let lost = traffic.nothing_came_twice()? - before;
    eprintln!("lost {lost} messages, one each 1 ms, when the link fell silent");
    ensure!(lost < LEFT.as_millis() as usize, "{lost} messages\n{}", ring.report());
    ensure!(ring.ctl(0, &["link", "list"])?["links"].as_array().is_some_and(|links| links.len() == 3), "QUIC is up");

    ring.cut_wire(false)?;
    by_s2(&mut ring)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    let lost = traffic.nothing_came_twice()? - before - lost;
    eprintln!("lost {lost} messages when it came back");
    ensure!(lost < LEFT.as_millis() as usize, "{lost} messages\n{}", ring.report());

    // A link that does so again and again is avoided although it works.
    for _ in 0..3 {
        ring.cut_wire(true)?;
        ring.wait("the silence to be noticed", |ring| Ok(!answers(ring)?))?;
        ring.cut_wire(false)?;
        ring.wait("an answer", answers)?;
    }
    ring.wait("s1 to suppress it", |ring| Ok(ring.switches[0].process.stderr().contains("again and again")))?;
    ensure!(ring.path()? == [0, 4, 3, 2], "{:?}", ring.path()?);
    by_s2(&mut ring)?;
    Ok(())
}

#[test]
fn an_idle_link_between_switches_that_falls_silent_is_left_within_seconds() -> Result<()> {
    let mut ring = Ring::start_with_wire(Tools::beside_this_test()?)?;
    by_s2(&mut ring)?;
    // Until now, the links had data.
    sleep(Duration::from_secs(11))?;
    ring.cut_wire(true)?;
    let cut = Instant::now();
    ring.wait("another path", |ring| Ok(ring.path()? == [0, 4, 3, 2]))?;
    eprintln!("left after {:?}", cut.elapsed());
    ensure!(cut.elapsed() < IDLE_TIMEOUT, "{:?}\n{}", cut.elapsed(), ring.report());
    Ok(())
}

#[test]
fn daemons_that_do_not_run_for_a_second_leave_no_link() -> Result<()> {
    let mut ring = Ring::start_with_wire(Tools::beside_this_test()?)?;
    let traffic = Traffic::start((&ring.robot, ring.folder_of("robot")), (&ring.cloud, ring.folder_of("cloud")))?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    by_s2(&mut ring)?;
    for stopped in [vec![0], vec![1], vec![0, 1, 2, 3, 4]] {
        for signal in [libc::SIGSTOP, libc::SIGCONT] {
            for i in &stopped {
                // SAFETY: sends a signal to a child that has not been waited for.
                ensure!(unsafe { libc::kill(ring.switches[*i].process.pid() as i32, signal) } == 0, "no such process");
            }
            sleep(Duration::from_secs(1))?;
        }
    }
    traffic.wait_for_more(500, TIMEOUT).with_context(|| ring.report())?;
    ensure!(traffic.nothing_came_twice()? == 0, "{}", traffic.summary());
    for switch in &ring.switches {
        ensure!(!switch.process.stderr().contains("does not answer"), "{}", switch.process.report());
    }
    Ok(())
}

/// There is no other path. The neighbour does not accept that s2 closes its link, because the
/// packet comes from another address.
#[test]
fn a_switch_whose_mac_address_changes_has_its_links_again_before_quic_notices() -> Result<()> {
    let fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions::default())?;
    let chain = &fabric.chain;
    let (robot, cloud) = ((chain.robot(), fabric.folder_of("robot")), (chain.cloud(), fabric.folder_of("cloud")));
    let traffic = Traffic::start(robot, cloud)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| fabric.report())?;
    // Of two neighbours, the one with the smaller name dials.
    for (interface, mac) in [("l0", "02:00:00:00:aa:01"), ("r0", "02:00:00:00:aa:02")] {
        let before = traffic.nothing_came_twice()?;
        chain.switches()[1].ip(&["link", "set", interface, "address", mac])?;
        traffic.wait_for_more(500, TIMEOUT).with_context(|| fabric.report())?;
        let lost = traffic.nothing_came_twice()? - before;
        eprintln!("lost {lost} messages, one each 1 ms, when the MAC address of {interface} changed");
        ensure!(lost < IDLE_TIMEOUT.as_millis() as usize / 2, "{interface}: {lost}\n{}", fabric.report());
    }
    Ok(())
}

/// Waits until s1 sends to the cloud by s2.
fn by_s2(ring: &mut Ring) -> Result<()> {
    ring.wait("the path by s2", |ring| Ok(ring.path()? == [0, 1, 2]))
}

/// Returns whether s1's link to s2 is up and answers.
fn answers(ring: &Ring) -> Result<bool> {
    let list = ring.ctl(0, &["link", "list"])?;
    let links = list["links"].as_array().context("links")?;
    Ok(links.iter().any(|link| link["peer"] == *ring.switches[1].name && link["answers"] == true))
}
