//! One workload on one setup: what each request took, and what the robot spent.
//!
//! Robot and edge stamp each request on one clock: when the robot writes it, when all of it is at
//! the edge, when the edge writes the reply, and when the reply is at the robot.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_tests::peers::percentile;
use gdp_tests::process::Process;
use gdp_tests::wait;
use serde::Serialize;
use serde_json::Value;

use super::site::Site;
use super::stages::Stages;
use super::tools::EvalTools;
use super::workload::Workload;

/// ORB-SLAM reads its vocabulary first.
const START: Duration = Duration::from_secs(60);

/// The robot waits this long for its last replies, and for each reply of a workload that asks one
/// request after the other.
const REPLY_TIMEOUT: Duration = Duration::from_secs(10);

/// Requests of a workload, and how fast they come.
#[derive(Clone, Copy)]
pub struct Requests {
    pub count: u32,
    /// Requests per second; only for SLAM, the others ask again once they have an answer.
    pub rate: f64,
}

impl Requests {
    /// Returns images for this many seconds.
    pub fn for_seconds(seconds: f64, is_quick: bool) -> Self {
        // A quick run is on programs that are slower, and maybe on a busy machine.
        let rate = if is_quick { 5.0 } else { 10.0 };
        Self { count: (seconds * rate) as u32, rate }
    }
}

/// A running workload.
pub struct RunningWorkload {
    robot: Process,
    edge: Process,
    workload: Workload,
    requests: Requests,
    before: Spent,
    since: Instant,
}

/// What the robot's programs have used so far.
#[derive(Clone, Copy)]
struct Spent {
    cpu: Duration,
    wakeups: u64,
    uplink: u64,
}

/// The times of one request, in nanoseconds of one clock. A step that did not happen is `None`.
#[derive(Clone, Default, Debug)]
pub struct Exchange {
    pub sent: Option<u64>,
    pub at_edge: Option<u64>,
    pub replied: Option<u64>,
    pub back: Option<u64>,
    /// Digests of the request, at the robot and at the edge.
    request: [Option<String>; 2],
    /// Digests of the reply, at the robot and at the edge.
    reply: [Option<String>; 2],
}

/// What a workload took, of all requests that were answered.
#[derive(Serialize)]
pub struct Trial {
    pub requests: usize,
    /// Requests without an answer.
    pub lost: usize,
    /// Requests or replies that are other bytes at the edge than at the robot.
    pub damaged: usize,
    pub to_edge_ms: Times,
    pub compute_ms: Times,
    pub to_robot_ms: Times,
    pub total_ms: Times,
    /// Processor time of the robot's programs per request, in milliseconds.
    pub robot_cpu_ms: f64,
    /// Voluntary context switches of the robot's programs per second.
    pub robot_wakeups: f64,
    /// Bytes on the robot's uplink per request, in both directions.
    pub uplink_bytes: f64,
    /// Whether the cable with faults lost only what it had to.
    pub is_comparable: bool,
    /// What the robot says of its results: errors of the trajectory, or a digest of all replies.
    pub result: Value,
    pub stages: Vec<Stages>,
}

#[derive(Clone, Copy, Serialize)]
pub struct Times {
    pub p50: f64,
    pub p99: f64,
}

impl RunningWorkload {
    /// Starts both programs, waits until a first request was answered, and lets the robot begin.
    pub fn start(
        tools: &EvalTools,
        site: &Site,
        workload: Workload,
        requests: Requests,
        folder: &Path,
    ) -> Result<Self> {
        let edge = |at: &_| tools.workload(at, "edge.py", workload.name());
        let mut edge = site.start_edge(edge, folder)?;
        edge.wait_event("ready", START)?;
        let gate = folder.join("gate");
        let robot = |at: &_| {
            let mut command = tools.workload(at, "robot.py", workload.name())?;
            command.args(["--count", &requests.count.to_string(), "--rate", &requests.rate.to_string()]);
            command.arg("--stay").arg("--gate").arg(&gate);
            Ok(command)
        };
        let mut robot = site.start_robot(robot, folder)?;
        robot.wait_event("matched", START).with_context(|| edge.report())?;
        let before = Spent::of(site, &robot, &edge)?;
        std::fs::write(&gate, "").with_context(|| format!("cannot write {}", gate.display()))?;
        Ok(Self { robot, edge, workload, requests, before, since: Instant::now() })
    }

    /// Returns the longest time in which all requests are answered or given up.
    fn limit(&self) -> Duration {
        REPLY_TIMEOUT * (self.requests.count + 1)
    }

    /// Returns the requests so far, in order.
    pub fn exchanges(&self) -> Vec<Exchange> {
        Exchange::join(&self.robot.json_lines(), &self.edge.json_lines())
    }

    /// Waits for the robot's results. It looks seldom, since it reads all output each time.
    fn wait_until_done(&mut self) -> Result<Value> {
        const LOOK: Duration = Duration::from_millis(250);
        let deadline = Instant::now() + self.limit();
        loop {
            wait::sleep(LOOK)?;
            if let Some(done) = self.robot.json_lines().into_iter().find(|line| line["event"] == "done") {
                return Ok(done);
            }
            self.robot.check_alive()?;
            self.edge.check_alive()?;
            ensure!(Instant::now() < deadline, "no end of the workload\n{}", self.robot.report());
        }
    }

    /// Waits until the robot has all its answers.
    pub fn finish(mut self, site: &Site) -> Result<Trial> {
        let result = self.wait_until_done()?;
        let (after, seconds) = (Spent::of(site, &self.robot, &self.edge)?, self.since.elapsed().as_secs_f64());
        let exchanges = self.exchanges();
        let answered: Vec<&Exchange> = exchanges.iter().filter(|exchange| exchange.back.is_some()).collect();
        let times = |of: fn(&Exchange) -> Option<u64>| Times::of(answered.iter().filter_map(|it| of(it)));
        let each = |total: f64| total / exchanges.len().max(1) as f64;
        Ok(Trial {
            requests: exchanges.len(),
            lost: exchanges.len() - answered.len(),
            damaged: exchanges.iter().filter(|exchange| exchange.is_damaged()).count(),
            to_edge_ms: times(|it| it.at_edge?.checked_sub(it.sent?)),
            compute_ms: times(|it| it.replied?.checked_sub(it.at_edge?)),
            to_robot_ms: times(|it| it.back?.checked_sub(it.replied?)),
            total_ms: times(|it| it.back?.checked_sub(it.sent?)),
            robot_cpu_ms: each(after.cpu.saturating_sub(self.before.cpu).as_secs_f64() * 1e3),
            robot_wakeups: after.wakeups.saturating_sub(self.before.wakeups) as f64 / seconds,
            uplink_bytes: each(after.uplink.saturating_sub(self.before.uplink) as f64),
            is_comparable: site.check_wire(),
            result,
            stages: Stages::of(site, self.workload),
        })
    }
}

impl Trial {
    /// Fails if a request was lost or changed, or if the workload has found nothing.
    pub fn check(&self, workload: Workload) -> Result<()> {
        ensure!(self.lost == 0, "{} of {} requests were lost", self.lost, self.requests);
        ensure!(self.damaged == 0, "{} of {} requests arrived changed", self.damaged, self.requests);
        ensure!(workload.has_found(&self.result), "without a useful result: {}", workload.result(&self.result));
        Ok(())
    }
}

impl Spent {
    fn of(site: &Site, robot: &Process, edge: &Process) -> Result<Self> {
        let computes = site.is_robot_only().then_some(edge);
        let processes = || [Some(robot), computes, site.robot_proxy()].into_iter().flatten();
        let cpu = processes().map(Process::cpu).sum::<Result<Duration>>()?;
        let wakeups = processes().map(|process| Ok(process.wakeups()?.values().sum::<u64>())).sum::<Result<u64>>()?;
        Ok(Self { cpu, wakeups, uplink: site.uplink_bytes()? })
    }
}

impl Exchange {
    /// Joins what robot and edge have printed, by the requests' numbers. Requests before the first
    /// that counts have negative numbers.
    fn join(robot: &[Value], edge: &[Value]) -> Vec<Self> {
        let mut all: BTreeMap<i64, Self> = BTreeMap::new();
        for line in robot {
            let Some(id) = line["id"].as_i64().filter(|id| *id >= 0) else { continue };
            match line["event"].as_str() {
                Some("request") => {
                    let exchange = all.entry(id).or_default();
                    exchange.sent = line["sent"].as_u64();
                    exchange.request[0] = text(&line["digest"]);
                }
                Some("reply") => {
                    let exchange = all.entry(id).or_default();
                    exchange.back = line["received"].as_u64();
                    exchange.reply[0] = text(&line["digest"]);
                }
                _ => (),
            }
        }
        for line in edge.iter().filter(|line| line["event"] == "compute") {
            let Some(exchange) = line["id"].as_i64().and_then(|id| all.get_mut(&id)) else { continue };
            exchange.at_edge = line["received"].as_u64();
            exchange.replied = line["replied"].as_u64();
            exchange.request[1] = text(&line["digest"]);
            exchange.reply[1] = text(&line["reply_digest"]);
        }
        all.into_values().collect()
    }

    fn is_damaged(&self) -> bool {
        [&self.request, &self.reply].iter().any(|it| matches!(it, [Some(here), Some(there)] if here != there))
    }
}

impl Times {
    fn of(nanoseconds: impl Iterator<Item = u64>) -> Self {
        let mut sorted: Vec<Duration> = nanoseconds.map(Duration::from_nanos).collect();
        sorted.sort();
        let at = |percent| percentile(&sorted, percent).as_secs_f64() * 1e3;
        Self { p50: at(50.0), p99: at(99.0) }
    }
}

/// Returns the longest time that a request took to the edge, of those that were under way then or
/// sent later. A request that has not arrived counts with its age.
pub fn slowest_since(exchanges: &[Exchange], since: u64) -> Result<Duration> {
    Ok(slowest(exchanges, since, monotonic()?))
}

fn slowest(exchanges: &[Exchange], since: u64, now: u64) -> Duration {
    let recent = exchanges.iter().filter(|it| it.at_edge.is_none_or(|at| at >= since));
    let age = |it: &Exchange| Some(it.at_edge.unwrap_or(now).saturating_sub(it.sent?));
    Duration::from_nanos(recent.filter_map(age).max().unwrap_or_default())
}

/// Returns the time of the clock that stamps requests, in nanoseconds.
pub fn monotonic() -> Result<u64> {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: a pointer to a live timespec.
    let result = unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut time) };
    ensure!(result == 0, "clock_gettime: {}", std::io::Error::last_os_error());
    Ok(time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64)
}

fn text(value: &Value) -> Option<String> {
    value.as_str().map(str::to_owned)
}

#[cfg(test)]
#[path = "../../tests/unit/trial.rs"]
mod tests;
