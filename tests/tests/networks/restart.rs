//! A daemon is killed under traffic, and a successor replaces it. Two SDK nodes are connected by
//! one switch, or by three:
//!
//! ```text
//!  robot r0 ──── l0 s1 r0 ──── l0 cloud
//!  publishes     killed         subscribes
//!
//!  robot r0 ──── l0 s1 r0 ──── l0 s2 r0 ──── l0 s3 r0 ──── l0 cloud
//!                edge           transit        edge, RIB
//! ```

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_link::link::IDLE_TIMEOUT;
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions};
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};

use crate::traffic::Traffic;

/// Longest time in which nodes notice that the switch is silent and reconnect.
const RECOVERY: Duration = Duration::from_secs(60);

#[test]
fn no_message_is_lost_when_a_daemon_is_killed_and_another_takes_over() -> Result<()> {
    let mut fabric = pinned_fabric(1)?;
    let traffic = start_traffic(&fabric)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| fabric.report())?;
    fabric.switches[0].process.kill()?;
    let killed = Instant::now();

    // Without a daemon, until both nodes have noticed, and longer.
    wait_for("both nodes to miss the switch", RECOVERY, || Ok((traffic.links_down() == 2).then_some(())))?;
    ensure!(killed.elapsed() > IDLE_TIMEOUT / 2);
    traffic.wait_for_more(1000, TIMEOUT).context("frames stopped while there was no daemon")?;
    traffic.nothing_is_missing()?;
    let stats = &fabric.xdp("stats")?["switches"][0];
    // The topic, and the names of the two ends.
    ensure!(stats["daemon"] == false && stats["links"] == 2 && stats["names"] == 3, "{stats}");
    ensure!(stats["counters"]["delivered"].as_u64().is_some_and(|delivered| delivered > 1500), "{stats}");

    fabric.start_again(0)?;
    wait_for("both nodes to have made their links anew", RECOVERY, || {
        fabric.switches[0].process.check_alive()?;
        Ok((traffic.links_made() == 4 && traffic.links_down() == 0).then_some(()))
    })
    .with_context(|| fabric.report())?;
    traffic.wait_for_more(500, TIMEOUT)?;
    wait_for("the name to lead to the new link", TIMEOUT, || {
        let (status, routes) = (fabric.status(0)?, fabric.ctl(0, &["fib", "dump"])?);
        let topic = routes["routes"].as_array().into_iter().flatten().find(|route| route["name"] == *fabric.name);
        let leads = topic.is_some_and(|topic| topic["readers"][0].is_string());
        Ok((status["rib"]["names"] == 1 && leads).then_some(()))
    })
    .with_context(|| fabric.report())?;
    traffic.wait_for_more(500, TIMEOUT)?;
    ensure!(fabric.switches[0].process.stderr().contains("took over"), "{}", fabric.report());
    traffic.nothing_is_missing()?;

    // Repeats the kill while the first link is still retained, and before any node notices. The
    // next daemon uses another build.
    fabric.tools.rebuild()?;
    fabric.switches[0].process.kill()?;
    fabric.start_again(0)?;
    wait_for("both nodes to have made their links anew", RECOVERY, || {
        fabric.switches[0].process.check_alive()?;
        Ok((traffic.links_made() == 6 && traffic.links_down() == 0).then_some(()))
    })
    .with_context(|| fabric.report())?;
    traffic.wait_for_more(500, TIMEOUT)?;
    let sent = traffic.stop_sending();
    traffic.wait_for_total(sent, TIMEOUT).with_context(|| format!("{}\n{}", traffic.summary(), fabric.report()))?;
    traffic.nothing_is_missing()?;
    ensure!(
        fabric.counter(0, "drop_no_route")? == 0 && fabric.counter(0, "drop_no_link")? == 0,
        "{}",
        fabric.status(0)?
    );
    Ok(())
}

#[test]
fn no_message_is_lost_when_any_switch_of_a_chain_is_killed_and_started_again() -> Result<()> {
    let mut fabric = pinned_fabric(3)?;
    let traffic = start_traffic(&fabric)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| fabric.report())?;
    // A reader that learns of a writer may greet it before the writer's switch has the route; the
    // reader repeats the greeting.
    let before = no_way(&fabric)?;
    // First restarts before any node notices, then after the neighbours have noticed.
    for (noticed, i) in [false, true].into_iter().flat_map(|noticed| [0, 1, 2].map(|i| (noticed, i))) {
        let what = format!("s{} was killed, noticed: {noticed}", i + 1);
        let before = traffic.links_made();
        fabric.switches[i].process.kill()?;
        if noticed {
            for near in [i.checked_sub(1), (i < 2).then_some(i + 1)].into_iter().flatten() {
                wait_for(
                    "a neighbour to miss the switch",
                    RECOVERY,
                    || Ok((links(&fabric, near)? == 1).then_some(())),
                )?;
            }
        }
        fabric.start_again(i)?;
        let ends_anew = if i == 1 { 0 } else { 1 };
        wait_for("all links to be made anew, and the RIB to know all", RECOVERY, || {
            fabric.switches[i].process.check_alive()?;
            let all_up = (0..3).all(|i| links(&fabric, i).is_ok_and(|links| links == 2)) && traffic.links_down() == 0;
            let anew = traffic.links_made() == before + ends_anew;
            Ok((all_up && anew && records(&fabric) == 2).then_some(()))
        })
        .with_context(|| format!("{what}\n{}\n{}", traffic.summary(), fabric.report()))?;
        traffic.wait_for_more(500, TIMEOUT)?;
        traffic.nothing_is_missing().with_context(|| format!("{what}\n{}", fabric.report()))?;
    }
    let sent = traffic.stop_sending();
    traffic.wait_for_total(sent, TIMEOUT).with_context(|| format!("{}\n{}", traffic.summary(), fabric.report()))?;
    traffic.nothing_is_missing()?;
    let after = no_way(&fabric)?;
    ensure!(after == before, "{before:?}, and then {after:?}");
    Ok(())
}

/// Returns the frames without a route or link in each switch of a chain, by drop reason.
fn no_way(fabric: &Fabric) -> Result<[[u64; 4]; 3]> {
    let reasons = ["drop_no_route", "drop_no_link", "drop_no_egress", "drop_not_permitted"];
    let mut counts = [[0; 4]; 3];
    for (i, of_switch) in counts.iter_mut().enumerate() {
        for (count, reason) in of_switch.iter_mut().zip(reasons) {
            *count = fabric.counter(i, reason)?;
        }
    }
    Ok(counts)
}

/// Returns the number of links of switch `i` that are up.
fn links(fabric: &Fabric, i: usize) -> Result<usize> {
    Ok(fabric.status(i)?["links"].as_array().map_or(0, Vec::len))
}

/// Returns the number of writers and readers that the RIB, at the last switch, knows.
fn records(fabric: &Fabric) -> usize {
    let dump = fabric.ctl(fabric.switches.len() - 1, &["rib", "dump"]);
    dump.ok().and_then(|dump| Some(dump["records"].as_array()?.len())).unwrap_or(0)
}

#[test]
fn a_stopped_daemon_leaves_nothing_and_a_killed_one_can_be_cleared_away() -> Result<()> {
    let mut fabric = pinned_fabric(1)?;
    let shown = |fabric: &Fabric| fabric.chain.switches()[0].ip(&["-o", "link", "show", "l0"]);
    ensure!(shown(&fabric)?.contains("xdp"));
    let refused = fabric.xdp("detach").err().context("a daemon runs")?.to_string();
    ensure!(refused.contains("a daemon runs"), "{refused}");
    ensure!(fabric.xdp("stats")?["switches"][0]["daemon"] == true);

    fabric.switches[0].process.stop(TIMEOUT)?;
    ensure!(!shown(&fabric)?.contains("xdp"), "a stop takes the programs off");
    ensure!(fabric.xdp("stats")?["switches"] == serde_json::json!([]));

    fabric.start_again(0)?;
    wait_for("the daemon to answer", TIMEOUT, || Ok(fabric.status(0).ok()))?;
    fabric.switches[0].process.kill()?;
    ensure!(shown(&fabric)?.contains("xdp"), "a crash leaves them");
    let detached = fabric.xdp("detach")?;
    ensure!(detached["detached"].as_array().map(Vec::len) == Some(1), "{detached}");
    wait_for("the programs to go", TIMEOUT, || Ok((!shown(&fabric)?.contains("xdp")).then_some(())))?;
    Ok(())
}

#[test]
fn a_daemon_that_is_to_be_kept_leaves_the_kernel_to_its_successor() -> Result<()> {
    let mut fabric = pinned_fabric(1)?;
    fabric.switches[0].process.stop(TIMEOUT)?;
    let mut command = fabric.chain.switches()[0].command(fabric.tools.gdp_ctl()?)?;
    command.args(["serve", "--keep", "--config"]).arg(fabric.folder().join("s1.yaml"));
    command.env("GDP_EBPF_OBJECT", fabric.tools.ebpf_object()?);
    let mut kept = Process::spawn("kept", command, fabric.folder())?;
    wait_for("the daemon to answer", TIMEOUT, || Ok(fabric.status(0).ok())).with_context(|| kept.report())?;
    ensure!(kept.stop(TIMEOUT)?.success(), "{}", kept.report());
    let stats = &fabric.xdp("stats")?["switches"][0];
    ensure!(stats["daemon"] == false && stats["programs"].as_array().map(Vec::len) == Some(2), "{stats}");

    fabric.start_again(0)?;
    // The daemon answers before it has examined its interfaces.
    let taken_over = |status: serde_json::Value| status["data_plane_reason"].to_string().contains("taken over");
    wait_for("the daemon to take over", TIMEOUT, || Ok(fabric.status(0).ok().is_some_and(taken_over).then_some(())))
        .with_context(|| fabric.report())
}

#[test]
fn maps_of_another_layout_or_version_are_refused_with_the_remedy() -> Result<()> {
    let mut fabric = pinned_fabric(1)?;
    let config = fabric.folder().join("s1.yaml");
    let text = std::fs::read_to_string(&config)?;
    fabric.switches[0].process.kill()?;
    let mut changed: serde_json::Value = serde_json::from_str(&text)?;
    changed["fib_capacity"] = 1000.into();
    let run = |fabric: &mut Fabric| -> Result<String> {
        let mut command = fabric.chain.switches()[0].command(fabric.tools.gdp_ctl()?)?;
        command.args(["serve", "--config"]).arg(&config).env("GDP_EBPF_OBJECT", fabric.tools.ebpf_object()?);
        let output = command.output()?;
        ensure!(output.status.code() == Some(1), "{output:?}");
        Ok(String::from_utf8_lossy(&output.stderr).into_owned())
    };
    std::fs::write(&config, changed.to_string())?;
    let refused = run(&mut fabric)?;
    ensure!(refused.contains("capacity is 65536") && refused.contains("needs 1000"), "{refused}");
    ensure!(refused.contains("gdp-ctl xdp detach"), "{refused}");

    // Simulates the state of another build.
    std::fs::write(&config, &text)?;
    let root = fabric.bpffs().join("gdp");
    let held = root.join(format!("v{}", gdp_wire::table::ABI));
    std::fs::rename(held, root.join("v0"))?;
    let refused = run(&mut fabric)?;
    ensure!(refused.contains("another version") && refused.contains("gdp-ctl xdp detach"), "{refused}");

    // The service's daemon removes it, with its programs, and starts anew.
    let mut command = fabric.chain.switches()[0].command(fabric.tools.gdp_ctl()?)?;
    command.args(["serve", "--keep", "--config"]).arg(&config).env("GDP_EBPF_OBJECT", fabric.tools.ebpf_object()?);
    let mut service = Process::spawn("service", command, fabric.folder())?;
    wait_for("the daemon to answer", TIMEOUT, || Ok(fabric.status(0).ok())).with_context(|| service.report())?;
    ensure!(service.stderr().contains("had another version of the kernel's maps"), "{}", service.report());
    ensure!(std::fs::read_dir(root.join("v0"))?.next().is_none(), "its pins are left");
    ensure!(service.stop(TIMEOUT)?.success(), "{}", service.report());
    ensure!(fabric.xdp("detach")?["detached"].as_array().map(Vec::len) == Some(1));
    fabric.start_again(0)?;
    wait_for("the daemon to answer", TIMEOUT, || Ok(fabric.status(0).ok())).with_context(|| fabric.report())?;
    Ok(())
}

fn pinned_fabric(switches: usize) -> Result<Fabric> {
    let chain = ChainOptions { switches, ..Default::default() };
    let options = FabricOptions { chain, pinned: true, ..Default::default() };
    let mut fabric = Fabric::start(Tools::beside_this_test()?, options)?;
    fabric.switches[0].process.check_alive()?;
    Ok(fabric)
}

fn start_traffic(fabric: &Fabric) -> Result<Traffic> {
    let end = |at, party| (at, fabric.folder_of(party));
    Traffic::start(end(fabric.chain.robot(), "robot"), end(fabric.chain.cloud(), "cloud"))
}
