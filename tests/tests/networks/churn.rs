//! Two hundred topics whose nodes come and go at both ends. At the end every route carries
//! messages, and the proxies' memory and processor use have not grown.
//!
//! ```text
//!   nodes, robot r0 ── l0 s1 r0 ── l0 cloud, nodes
//! ```

use std::fs;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::chain::{Chain, ChainOptions};
use gdp_tests::fabric::{Authority, Switch, TYPE};
use gdp_tests::netns::Namespace;
use gdp_tests::process::Process;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::json;

const TOPICS: usize = 200;

/// Seconds during which nodes come and go; `GDP_CHURN_SECONDS` overrides this.
const SECONDS: u64 = 24;

/// Longest time until everything is discovered, on two cores.
const SETTLED: Duration = Duration::from_secs(60);

#[test]
fn nodes_come_and_go_and_every_route_still_carries() -> Result<()> {
    let seconds = std::env::var("GDP_CHURN_SECONDS").ok().and_then(|text| text.parse().ok()).unwrap_or(SECONDS);
    let tools = Tools::beside_this_test()?;
    let chain = Chain::build(ChainOptions { switches: 1, ..Default::default() })?;
    let files = tempfile::Builder::new().prefix("gdp-churn-").tempdir()?;
    let folder = files.path();
    let authority = Authority { tools: &tools, folder };
    let name = authority.switch("s1")?;
    let config = json!({"interfaces": ["l0", "r0"], "udp": null, "data_plane": "xdp", "bpffs": null, "rib": true});
    let switch = Switch::start(&tools, &chain.switches()[0], folder, ("s1", &name), config)?;
    wait_for("the switch", TIMEOUT, || Ok(switch.ctl(&tools, &["status"]).ok()))?;
    let mut proxies = proxies(&tools, &chain, &authority)?;

    let gate = folder.join("gate");
    let mut talkers = churn(&tools, chain.robot(), "talk", &gate, folder)?;
    let mut listeners = churn(&tools, chain.cloud(), "listen", &gate, folder)?;
    let report = |proxies: &[Process]| proxies.iter().map(Process::report).collect::<String>();
    let begun = listeners.wait_until("most topics", SETTLED, |p| (heard(p, false)? > TOPICS / 2).then_some(()));
    begun.with_context(|| report(&proxies))?;
    std::thread::sleep(Duration::from_secs(seconds / 3));
    let usage = || proxies.iter().map(Usage::of).collect::<Result<Vec<_>>>();
    let third = || std::thread::sleep(Duration::from_secs(seconds / 3));
    let early = usage()?;
    third();
    let middle = usage()?;
    third();
    let late = usage()?;

    fs::write(&gate, "")?;
    let settled = listeners.wait_until("every topic", SETTLED, |p| (heard(p, true)? == TOPICS).then_some(()));
    settled.with_context(|| report(&proxies))?;
    for process in proxies.iter_mut().chain([&mut talkers, &mut listeners]) {
        process.check_alive()?;
    }
    let last = listeners.json_lines().pop().context("a last line")?;
    println!(
        "{} nodes came at the listening end; a third of {seconds} s apart: {early:?}, {middle:?}, {late:?}",
        last["nodes"]
    );
    for ((early, middle), late) in early.iter().zip(&middle).zip(&late) {
        let (before, after) = (middle.cpu_ticks - early.cpu_ticks, late.cpu_ticks - middle.cpu_ticks);
        // The margin covers work that was delayed by other load on this machine.
        ensure!(after < before * 3 + 50, "gets busier: {before} ticks, then as long after {after}");
        // An allocator does not return all freed memory.
        ensure!(late.resident_kb < early.resident_kb * 5 / 4 + 8192, "grows: {early:?}, then {late:?}");
    }
    Ok(())
}

/// Returns the number of topics in the listeners' last line. With `settled`, returns it only once
/// everything has settled.
fn heard(listeners: &Process, settled: bool) -> Option<usize> {
    let last = listeners.json_lines().pop().filter(|line| line["event"] == "heard")?;
    (!settled || last["settled"] == true).then(|| last["topics"].as_u64().unwrap_or(0) as usize)
}

fn churn(tools: &Tools, at: &Namespace, verb: &str, gate: &Path, folder: &Path) -> Result<Process> {
    let mut command = at.command(tools.python()?)?;
    command.arg(tools.peer("any/churn.py")).args([verb, &TOPICS.to_string()]).arg(gate);
    Process::spawn(verb, command, folder)
}

fn proxies(tools: &Tools, chain: &Chain, authority: &Authority<'_>) -> Result<Vec<Process>> {
    authority.topic()?;
    let sides = [
        ("robot", "out", "cert", "--publish", chain.robot(), "r0"),
        ("cloud", "in", "grant", "--read", chain.cloud(), "l0"),
    ];
    let entities = sides.iter().map(|(label, ..)| authority.proxy(label)).collect::<Result<Vec<_>>>()?;
    for number in 0..TOPICS {
        authority.name("topic", &format!("/churn/t{number}"), TYPE, &format!("{number}.card"))?;
        for ((label, _, _, right, ..), entity) in sides.iter().zip(&entities) {
            authority.hand(label, entity, &[right], &number.to_string())?;
        }
    }
    let start = |(label, direction, key, _, at, interface): (&str, &str, &str, &str, &Namespace, &str)| {
        at.enable_loopback_multicast()?;
        let topic = |number: usize| {
            let (card, cert) = (format!("{number}.card"), format!("{number}.cert"));
            json!({"topic": format!("/churn/t{number}"), "direction": direction, "card": card, (key): cert})
        };
        let config = json!({
            "version": 1, "identity": "key.pem", "links": [{"to": format!("eth://{interface}")}],
            "graphs": {"ros2": {"domain_id": 0}}, "topics": (0..TOPICS).map(topic).collect::<Vec<_>>(),
        });
        let path = authority.folder.join(label).join("proxy.yaml");
        // JSON is YAML.
        fs::write(&path, config.to_string())?;
        let mut command = at.command(tools.gdp_proxy()?)?;
        command.arg("--config").arg(path);
        Process::spawn(&format!("{label}-proxy"), command, authority.folder)
    };
    sides.into_iter().map(start).collect()
}

/// Resources that a process has used so far.
#[derive(Debug)]
struct Usage {
    resident_kb: u64,
    cpu_ticks: u64,
}

impl Usage {
    fn of(process: &Process) -> Result<Self> {
        let read = |file: &str| {
            let path = format!("/proc/{}/{file}", process.pid());
            fs::read_to_string(&path).with_context(|| path)
        };
        let status = read("status")?;
        let resident =
            status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.split_whitespace().next()?.parse().ok());
        let stat = read("stat")?;
        let after = stat.rsplit_once(')').context("a stat line")?.1;
        let ticks = |field: usize| after.split_whitespace().nth(field).and_then(|text| text.parse::<u64>().ok());
        let (user, system) = (ticks(11).context("user time")?, ticks(12).context("system time")?);
        Ok(Self { resident_kb: resident.context("VmRSS")?, cpu_ticks: user + system })
    }
}
