//! Distinguishes silence from absence, under DDS traffic from robot to cloud. A link whose peer's
//! daemon died stays up while the peer's kernel answers echoes. A link whose cable is cut does not,
//! until the cable is mended.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_core::peer::GRACEFUL_RESTART_TIME;
use gdp_link::link::{IDLE_TIMEOUT, liveness::Pace};
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::peers::{self, Conversation, Side, Traffic, Vendor};
use gdp_tests::wait::{TIMEOUT, sleep, wait_for};
use serde_json::Value;

/// Time until a link without any answer is closed: QUIC's idle timeout, the echo timeout, and the
/// same again for a loaded machine. Far less than the graceful restart time.
const GIVEN_UP: Duration = Duration::from_secs(2 * (IDLE_TIMEOUT.as_secs() + 1));
const _: () = assert!(GIVEN_UP.as_secs() < GRACEFUL_RESTART_TIME.as_secs() / 2);

#[test]
fn a_switch_whose_daemon_died_is_held_by_its_neighbours_while_its_kernel_forwards() -> Result<()> {
    let mut fabric = fabric(FabricOptions { pinned: true, ..Default::default() })?;
    let mut conversation = converse(&fabric)?;
    wait_for_more(&mut conversation, 10)?;
    kill_s2(&mut fabric)?;
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
    kill_s2(&mut fabric)?;
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

/// Kills the daemon of s2, and waits until both neighbours hold their links to it.
fn kill_s2(fabric: &mut Fabric) -> Result<()> {
    fabric.switches[1].process.kill()?;
    for neighbour in [0, 2] {
        wait_for("the neighbour to hear nothing more", GIVEN_UP, || Ok(held(fabric, neighbour, 1)?.map(drop)))
            .with_context(|| fabric.report())?;
    }
    Ok(())
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
