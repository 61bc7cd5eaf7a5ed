//! A chain of switches is upgraded, switch by switch, under traffic. The SDK nodes at its ends are
//! of this source from the start:
//!
//! ```text
//!  robot r0 ──── l0 s1 r0 ──── l0 s2 r0 ──── l0 s3 r0 ──── l0 cloud
//!                1.             2.            3., RIB
//! ```
//!
//! `cargo xtask package rolling-upgrade` starts from the package of another revision. Without it,
//! both versions are builds of this source.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::wait::{TIMEOUT, wait_for};

use crate::traffic::Traffic;

/// The environment variable with the folder of the previous package's executables.
const PREVIOUS: &str = "GDP_PREVIOUS_PACKAGE";

#[test]
fn no_message_is_lost_while_the_switches_of_a_chain_are_upgraded_one_by_one() -> Result<()> {
    let mut tools = Tools::beside_this_test()?;
    let previous = match std::env::var_os(PREVIOUS) {
        Some(folder) => tools.of_package(PathBuf::from(folder)),
        None => tools.clone(),
    };
    tools.rebuild()?;
    let mut fabric = Fabric::start(previous, FabricOptions { pinned: true, kept: true, ..Default::default() })?;
    let end = |at, party| (at, fabric.folder_of(party));
    let traffic = Traffic::start(end(fabric.chain.robot(), "robot"), end(fabric.chain.cloud(), "cloud"))?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| fabric.report())?;
    fabric.tools = tools;
    for i in 0..3 {
        let what = format!("s{} was upgraded", i + 1);
        let stopped = fabric.switches[i].process.stop(TIMEOUT)?;
        ensure!(stopped.success(), "{what}: {stopped}\n{}", fabric.report());
        fabric.start_again(i)?;
        wait_for("all links to be up", TIMEOUT, || {
            fabric.switches[i].process.check_alive()?;
            let links = |i| fabric.status(i).ok().and_then(|status| Some(status["links"].as_array()?.len()));
            Ok(((0..3).all(|i| links(i) == Some(2)) && traffic.links_down() == 0).then_some(()))
        })
        .with_context(|| format!("{what}\n{}\n{}", traffic.summary(), fabric.report()))?;
        ensure!(fabric.switches[i].process.stderr().contains("took over"), "{what}: {}", fabric.report());
        traffic.wait_for_more(500, TIMEOUT).with_context(|| format!("{what}\n{}", fabric.report()))?;
        traffic.nothing_is_missing().with_context(|| format!("{what}\n{}", fabric.report()))?;
    }
    let sent = traffic.stop_sending();
    traffic.wait_for_total(sent, TIMEOUT).with_context(|| format!("{}\n{}", traffic.summary(), fabric.report()))?;
    traffic.nothing_is_missing()
}
