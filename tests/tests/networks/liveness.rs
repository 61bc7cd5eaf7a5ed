//! Distinguishes silence from absence. A link whose peer's daemon died stays up while the peer's
//! kernel answers echoes. A link whose cable passes nothing is left within a third of a second,
//! although it has a carrier, and used again once it is mended.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_core::peer::GRACEFUL_RESTART_TIME;
use gdp_link::link::{IDLE_TIMEOUT, liveness::Pace};
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::peers::{self, Conversation, Side, Traffic, Vendor};
use gdp_tests::ring::Ring;
use gdp_tests::wait::{TIMEOUT, sleep, wait_for};
use serde_json::Value;

use crate::traffic::Traffic;

/// Time until a link without any answer is closed: QUIC's idle timeout, the echo timeout, and the
/// same again for a loaded machine. Far less than the graceful restart time.
const GIVEN_UP: Duration = Duration::from_secs(2 * (IDLE_TIMEOUT.as_secs() + 1));
/// Longest gap when a link with data falls silent, on a loaded machine. QUIC alone takes
/// [`IDLE_TIMEOUT`] and a second.
const LEFT: Duration = Duration::from_secs(1);
const _: () = assert!(GIVEN_UP.as_secs() < GRACEFUL_RESTART_TIME.as_secs() / 2);

#[test]
fn a_switch_whose_daemon_died_is_held_by_its_neighbours_while_its_kernel_forwards() -> Result<()> {
    let mut fabric = fabric(FabricOptions { pinned: true, ..Default::default() })?;
    let mut conversation = converse(&fabric)?;
    wait_for_more(&mut conversation, 10)?;
    fabric.switches[1].process.kill()?;
    for neighbour in [0, 2] {
        wait_for("the neighbour to hear nothing more", GIVEN_UP, || Ok(held(&fabric, neighbour, 1)?.map(drop)))
            .with_context(|| fabric.report())?;
    }
    // Far longer than a dead switch's link would stay up.
    let echoes = 2 * 5 * Pace::ETHERNET.misses as u64;
    let before = echoed(&fabric, 1)?;
    wait_for("the kernel to answer echoes", TIMEOUT, || Ok((echoed(&fabric, 1)? >= before + echoes).then_some(())))?;
    for neighbour in [0, 2] {
        let link = held(&fabric, neighbour, 1)?.context("it is held on")?;
        ensure!(link["role"] == "switch" && link["errors_received"] == serde_json::json!({}), "{link}");
    }
    wait_for_more(&mut conversation, 10)?;
    nothing_is_missing(&conversation)?;

    fabric.chain.switches()[1].ip(&["link", "set", "l0", "down"])?;
    let answers = |fabric: &Fabric, neighbour| {
        Ok::<_, anyhow::Error>(held(fabric, neighbour, 1)?.context("held")?["answers"] == true)
    };
    wait_for("the left neighbour to leave it", GIVEN_UP, || Ok((!answers(&fabric, 0)?).then_some(())))?;
    ensure!(answers(&fabric, 2)?, "the right cable is whole");
    Ok(())
}

/// Without its daemon, s2 cannot make a link anew. The held one is used again.
#[test]
fn a_link_that_is_held_survives_a_cable_that_fails_for_a_while() -> Result<()> {
    let chain = ChainOptions { wire: Some(1), ..Default::default() };
    let mut fabric = fabric(FabricOptions { chain, depth: 10_000, pinned: true, ..Default::default() })?;
    let mut conversation = converse(&fabric)?;
    wait_for_more(&mut conversation, 10)?;
    fabric.switches[1].process.kill()?;
    for neighbour in [0, 2] {
        wait_for("the neighbour to hear nothing more", GIVEN_UP, || Ok(held(&fabric, neighbour, 1)?.map(drop)))
            .with_context(|| fabric.report())?;
    }
    wait_for_more(&mut conversation, 10)?;
    for _ in 0..2 {
        fabric.chain.cut_wire(true)?;
        wait_for("s1 to leave it", GIVEN_UP, || {
            Ok(held(&fabric, 0, 1)?.is_some_and(|link| link["answers"] == false).then_some(()))
        })
        .with_context(|| fabric.report())?;
        sleep(Duration::from_secs(1))?;
        fabric.chain.cut_wire(false)?;
        let mended = Instant::now();
        wait_for_more(&mut conversation, 1).with_context(|| fabric.report())?;
        eprintln!("the first message {:?} after the cable was mended", mended.elapsed());
        ensure!(mended.elapsed() < GIVEN_UP, "{:?}", mended.elapsed());
        wait_for_more(&mut conversation, 10)?;
    }
    nothing_is_missing(&conversation)
}

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

/// There is no other path. The neighbour does not accept that s2 closes its link, because the packet
/// comes from another address.
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

#[test]
fn a_cut_cable_ends_the_hold_on_both_sides_and_a_mended_one_carries_again() -> Result<()> {
    let chain = ChainOptions { wire: Some(0), ..Default::default() };
    // The reader may later ask for everything that the robot writes meanwhile.
    let mut fabric = fabric(FabricOptions { chain, depth: 10_000, ..Default::default() })?;
    let mut conversation = converse(&fabric)?;
    wait_for_more(&mut conversation, 10)?;
    fabric.chain.cut_wire(true)?;
    wait_for("the robot to give the switch up", GIVEN_UP, || {
        Ok(fabric.proxy_stats("robot")["switch"].is_null().then_some(()))
    })
    .with_context(|| fabric.report())?;
    wait_for("the switch to give the robot up", GIVEN_UP, || {
        let status = fabric.status(0)?;
        let all =
            ["links", "links_in_grace"].map(|links| status[links].as_array().cloned().unwrap_or_default()).concat();
        Ok(all.iter().all(|link| link["role"] != "endpoint").then_some(()))
    })
    .with_context(|| fabric.report())?;
    fabric.chain.cut_wire(false)?;
    wait_for("the robot to be back", TIMEOUT, || Ok(fabric.proxy_stats("robot")["switch"].as_str().map(drop)))?;
    fabric.wait_for_route()?;
    wait_for_more(&mut conversation, 10)?;
    nothing_is_missing(&conversation)
}

fn fabric(options: FabricOptions) -> Result<Fabric> {
    let mut fabric = Fabric::start(Tools::beside_this_test()?, options)?;
    fabric.start_proxies()?;
    Ok(fabric)
}

fn converse(fabric: &Fabric) -> Result<Conversation> {
    let traffic = Traffic::default();
    let talks = Side { at: fabric.chain.robot(), vendor: Vendor::Cyclone, traffic: &traffic };
    let hears = Side { at: fabric.chain.cloud(), vendor: Vendor::FastDds, traffic: &traffic };
    let conversation = Conversation::start(&fabric.tools, talks, hears, fabric.folder())?;
    conversation.open()?;
    Ok(conversation)
}

fn wait_for_more(conversation: &mut Conversation, more: usize) -> Result<()> {
    let so_far = peers::received(&conversation.listener).len();
    let listener = &mut conversation.listener;
    listener.wait_until("more messages", TIMEOUT, |p| (peers::received(p).len() >= so_far + more).then_some(()))
}

fn nothing_is_missing(conversation: &Conversation) -> Result<()> {
    let numbers: Vec<i64> = peers::received(&conversation.listener).iter().map(|message| message.sequence).collect();
    ensure!(numbers == (0..numbers.len() as i64).collect::<Vec<_>>(), "a message was lost: {numbers:?}");
    Ok(())
}

/// Returns the status that switch `i` reports of its retained link to switch `to`.
fn held(fabric: &Fabric, i: usize, to: usize) -> Result<Option<Value>> {
    let status = fabric.status(i)?;
    let links = status["links_in_grace"].as_array().context("links")?;
    Ok(links.iter().find(|link| link["peer"] == *fabric.switches[to].name).cloned())
}

/// Returns the echoes that the kernel of switch `i` answered, with or without its daemon.
fn echoed(fabric: &Fabric, i: usize) -> Result<u64> {
    let stats = fabric.xdp("stats")?;
    let switches = stats["switches"].as_array().context("switches")?;
    // The output identifies a switch by the first digits of its name.
    let is_it = |switch: &&Value| switch["switch"].as_str().is_some_and(|id| fabric.switches[i].name.starts_with(id));
    let found = switches.iter().find(is_it);
    Ok(found.with_context(|| stats.to_string())?["counters"]["echoed"].as_u64().unwrap_or(0))
}
