//! Runs a contender's messages over a site for a while.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use gdp_tests::measure::rounds::Sample;
use gdp_tests::wait::wait_for;

use crate::lane::{Lane, Load, Received};
use crate::site::{Ends, Site};
use crate::usage::{self, Meter};

/// Starts the carrier of messages from the robot to the cloud, lane by lane.
pub type Open = fn(&Ends, &[Arc<Lane>]) -> Result<Carrier>;

pub struct Carrier {
    /// Returns the cloud's drops so far, by reason, if it counts them.
    pub drops: Box<dyn Fn() -> Drops>,
    /// Closes the carrier.
    pub close: Pin<Box<dyn Future<Output = ()> + Send>>,
}

pub type Drops = BTreeMap<&'static str, u64>;

impl Carrier {
    /// Returns a carrier that counts no drops.
    pub fn closed_by(close: impl Future<Output = ()> + Send + 'static) -> Self {
        Self { drops: Box::new(Drops::new), close: Box::pin(close) }
    }
}

/// Results of one measurement.
pub struct Seen {
    /// Mean number of CPUs that both ends kept busy.
    pub cpus: f64,
    /// The cloud's drops per second, by reason.
    pub drops: BTreeMap<&'static str, f64>,
    /// Resident bytes of this process, which contains both ends, at the beginning and at the end of
    /// the measurement.
    pub resident: [f64; 2],
    /// One result per lane.
    pub lanes: Vec<SeenLane>,
}

pub struct SeenLane {
    /// Messages per second, from one arrival to another. Messages in flight at the beginning or end
    /// of the measurement do not change this rate.
    pub rate: f64,
    /// Bytes of message bodies.
    pub bytes_per_second: f64,
    /// Latencies in nanoseconds, sorted.
    pub latencies: Vec<u64>,
    /// Messages from start to end, including those before the measurement. Messages that arrive too
    /// late for the end also count as lost.
    pub sent: u64,
    pub lost: u64,
}

/// Longest time until the first messages arrive. With a transport that loses frames, some sizes
/// never arrive.
const FIRST: Duration = Duration::from_secs(2);

/// Warm-up time after the first messages.
const WARM_UP: Duration = Duration::from_millis(200);

/// Time without arrivals after which no more are expected.
const SILENCE: Duration = Duration::from_millis(500);

/// Longest time until the last messages arrive.
const LAST: Duration = Duration::from_secs(3);

/// Sends messages of all loads at once, for `duration`. `cpus`: of the robot, of the cloud.
pub fn run(site: &Site, open: Open, loads: &[Load], cpus: [usize; 2], duration: Duration) -> Result<Seen> {
    let ends = site.ends(cpus)?;
    let meter = Meter::new(site.chain())?;
    let lanes: Vec<Arc<Lane>> = loads.iter().copied().map(Lane::new).collect();
    let Carrier { drops, close } = open(&ends, &lanes)?;

    let begun = Instant::now();
    wait_for("first messages", 2 * FIRST, || {
        let all = lanes.iter().all(|lane| lane.received().count > 0);
        lanes.iter().try_for_each(|lane| lane.check())?;
        Ok((all || begun.elapsed() > FIRST).then_some(()))
    })?;
    std::thread::sleep(WARM_UP);
    lanes.iter().for_each(|lane| drop(lane.take_latencies()));
    let before: Vec<Received> = lanes.iter().map(|lane| lane.received()).collect();
    let (resident, dropped) = (usage::resident()?, drops());
    let (start, cpu) = (Instant::now(), meter.total()?);
    std::thread::sleep(duration);
    let cpu = meter.total()?.saturating_sub(cpu);
    let after: Vec<Received> = lanes.iter().map(|lane| lane.received()).collect();
    let seconds = start.elapsed().as_secs_f64();
    let cpus = cpu.as_secs_f64() / seconds;
    let resident = [resident, usage::resident()?];
    let since = |(reason, count)| (reason, (count - dropped.get(reason).copied().unwrap_or(0)) as f64 / seconds);
    let drops = drops().into_iter().map(since).collect();
    lanes.iter().try_for_each(|lane| lane.check())?;

    lanes.iter().for_each(|lane| lane.stop());
    settle(&lanes)?;
    // A peer that does not answer does not affect the measurement.
    let closed = async { tokio::time::timeout(FIRST, close).await };
    let _ = ends.robot.inside.runtime.block_on(closed);
    let seen = lanes.iter().zip(before).zip(after).map(|((lane, before), after)| {
        let mut latencies = lane.take_latencies();
        latencies.sort_unstable();
        let (messages, took) = (after.count - before.count, after.last - before.last);
        let rate = if messages > 0 { messages as f64 * 1e9 / took as f64 } else { 0.0 };
        let (sent, lost) = (lane.sent(), lane.sent().saturating_sub(lane.received().count));
        SeenLane { rate, bytes_per_second: rate * lane.bytes() as f64, latencies, sent, lost }
    });
    Ok(Seen { cpus, drops, resident, lanes: seen.collect() })
}

/// Waits until no more messages arrive.
fn settle(lanes: &[Arc<Lane>]) -> Result<()> {
    let count = || lanes.iter().map(|lane| lane.received().count).sum::<u64>();
    let (mut last, mut since, begun) = (count(), Instant::now(), Instant::now());
    wait_for("the last messages", 2 * LAST, || {
        if count() != last {
            (last, since) = (count(), Instant::now());
        }
        let all = lanes.iter().all(|lane| lane.received().count >= lane.sent());
        Ok((since.elapsed() > SILENCE || begun.elapsed() > LAST || all).then_some(()))
    })
}

impl SeenLane {
    /// Returns a sample with the lane's losses.
    pub fn sample(&self, value: f64) -> Sample {
        Sample { value, sent: self.sent, lost: self.lost }
    }
}
