//! Messages of unmodified DDS programs across three XDP switches, and what happens when parts come and go.

use std::time::Duration;

use anyhow::{Result, ensure};
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions, PATIENCE, TOPIC, TYPE};
use gdp_tests::packet::is_gdp_data;
use gdp_tests::peers::{self, Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::wait::wait_for;

#[test]
fn cyclone_talks_to_fast_dds() -> Result<()> {
    crosses(Vendor::Cyclone, Vendor::FastDds)
}

#[test]
fn fast_dds_talks_to_cyclone() -> Result<()> {
    crosses(Vendor::FastDds, Vendor::Cyclone)
}

fn crosses(from: Vendor, to: Vendor) -> Result<()> {
    let chain = ChainOptions { wire: Some(1), ..Default::default() };
    let mut fabric = started(FabricOptions { chain, ..Default::default() })?;
    let traffic = Traffic { count: 40, ..Default::default() };
    let mut both = conversation(&fabric, from, to, &traffic)?;
    let before = kernel_forwards(&fabric)?;
    let eavesdropper = fabric.chain.wire_from_robot()?;
    both.open()?;
    let frame = eavesdropper.receive(PATIENCE, is_gdp_data)?;
    let messages = both.finish(PATIENCE, PATIENCE)?;
    complete_and_intact(&messages, &traffic)?;

    for (i, (before, after)) in before.iter().zip(kernel_forwards(&fabric)?).enumerate() {
        ensure!(after - before >= traffic.count, "s{} forwarded only {} frames in the kernel", i + 1, after - before);
    }
    for word in [TOPIC, TYPE, &traffic.text, "chatter", "String", "hello"] {
        let seen = frame.windows(word.len()).any(|window| window.eq_ignore_ascii_case(word.as_bytes()));
        ensure!(!seen, "{word} can be read on the wire");
    }
    for process in fabric.robot.iter_mut().chain(&mut fabric.cloud) {
        process.check_alive()?;
    }
    Ok(())
}

#[test]
fn a_megabyte_crosses_whole() -> Result<()> {
    let fabric = started(FabricOptions::default())?;
    let traffic = Traffic { count: 5, rate: 2.0, size: 1 << 20, ..Default::default() };
    let mut both = conversation(&fabric, Vendor::Cyclone, Vendor::FastDds, &traffic)?;
    both.open()?;
    complete_and_intact(&both.finish(PATIENCE, PATIENCE)?, &traffic)
}

#[test]
fn a_killed_publisher_is_forgotten_everywhere_and_welcome_again() -> Result<()> {
    let mut fabric = started(FabricOptions::default())?;
    let last = fabric.switches.len() - 1;
    let name = fabric.name.clone();
    let writers = |fabric: &Fabric| -> Result<usize> {
        let answer = fabric.ctl(last, &["query", &name])?;
        let records = answer["records"].as_array().into_iter().flatten();
        Ok(records.filter(|record| record["role"] == "publisher").count())
    };
    ensure!(writers(&fabric)? == 1);
    let mut robot = fabric.robot.take().expect("started");
    robot.kill()?;
    for i in [0, last] {
        fabric.wait_for_fib(i, false)?;
    }
    wait_for("the RIB to forget the writer", PATIENCE, || Ok((writers(&fabric)? == 0).then_some(())))?;

    fabric.start_robot()?;
    fabric.wait_for_route()?;
    let traffic = Traffic { count: 10, ..Default::default() };
    let mut both = conversation(&fabric, Vendor::Cyclone, Vendor::FastDds, &traffic)?;
    both.open()?;
    complete_and_intact(&both.finish(PATIENCE, PATIENCE)?, &traffic)
}

#[test]
fn a_listener_that_joins_late_gets_what_comes_then() -> Result<()> {
    let mut fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions::default())?;
    fabric.start_robot()?;
    let traffic = Traffic::default();
    let folder = fabric.folder().to_owned();
    let mut talker = peers::talker(&fabric.tools, fabric.chain.robot(), Vendor::Cyclone, &traffic, &folder)?;
    talker.wait_event("matched", PATIENCE)?;
    // It has talked into the void, which shows as frames without a route; now somebody comes.
    wait_for("frames without a route", PATIENCE, || Ok((fabric.counter(0, "drop_no_route")? > 2).then_some(())))?;
    fabric.start_cloud()?;
    fabric.wait_for_route()?;
    let mut listener = peers::listener(&fabric.tools, fabric.chain.cloud(), Vendor::FastDds, &traffic, &folder)?;
    let messages = listener
        .wait_until("ten messages", PATIENCE, |p| Some(peers::received(p)).filter(|messages| messages.len() >= 10))?;
    ensure!(messages.iter().all(|m| m.intact), "{messages:?}");
    ensure!(messages[0].sequence > 0, "the listener cannot have heard the first message");
    ensure!(messages.windows(2).all(|pair| pair[0].sequence + 1 == pair[1].sequence), "a gap in {messages:?}");
    Ok(())
}

/// Nobody reads the name: the first switch drops and counts, and no other switch sees anything.
#[test]
fn an_unknown_name_goes_no_further_than_the_first_switch() -> Result<()> {
    let mut fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions::default())?;
    fabric.start_robot()?;
    let folder = fabric.folder().to_owned();
    let traffic = Traffic::default();
    let _talker = peers::talker(&fabric.tools, fabric.chain.robot(), Vendor::FastDds, &traffic, &folder)?;
    wait_for("frames without a route", PATIENCE, || Ok((fabric.counter(0, "drop_no_route")? >= 10).then_some(())))?;
    ensure!(!fabric.holds_name(0)?, "no subscriber, so nothing may be in the FIB");
    for i in 0..fabric.switches.len() {
        ensure!(forwards(&fabric, i)? == 0, "s{} forwarded frames to nobody", i + 1);
    }
    Ok(())
}

fn started(options: FabricOptions) -> Result<Fabric> {
    let mut fabric = Fabric::start(Tools::beside_this_test()?, options)?;
    fabric.start_proxies()?;
    Ok(fabric)
}

fn conversation(fabric: &Fabric, from: Vendor, to: Vendor, traffic: &Traffic) -> Result<Conversation> {
    let talks = Side { at: fabric.chain.robot(), vendor: from, traffic };
    let hears = Side { at: fabric.chain.cloud(), vendor: to, traffic };
    Conversation::start(&fabric.tools, talks, hears, fabric.folder()).map_err(|e| e.context(fabric.report()))
}

fn complete_and_intact(messages: &[Received], traffic: &Traffic) -> Result<()> {
    let sequences: Vec<i64> = messages.iter().map(|message| message.sequence).collect();
    ensure!(sequences == (0..traffic.count as i64).collect::<Vec<_>>(), "expected all, once, in order: {sequences:?}");
    ensure!(messages.iter().all(|m| m.intact && m.bytes == traffic.size as u64), "damaged: {messages:?}");
    ensure!(messages.iter().all(|m| m.latency < Duration::from_secs(1)), "late: {messages:?}");
    Ok(())
}

fn kernel_forwards(fabric: &Fabric) -> Result<Vec<u64>> {
    (0..fabric.switches.len()).map(|i| fabric.forwarded_in_kernel(i)).collect()
}

/// Data frames that any plane of switch `i` sent on.
fn forwards(fabric: &Fabric, i: usize) -> Result<u64> {
    Ok(fabric.counter(i, "forwarded")? + fabric.counter(i, "delivered")?)
}
