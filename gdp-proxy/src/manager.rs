//! Reconciles the wanted plans with the running ones. The manager begins new plans, ends unwanted
//! ones, and leaves unchanged ones alone.
//!
//! A [`Plan`] describes what to run and has a key. A [`Work`] is the task that runs for it. At most
//! one work runs for each key: its successor begins when it has ended. The manager begins a failed
//! work again, because ROS graphs recover. [`Manager::failed`] returns the errors that only a
//! restart of the proxy can fix.

use std::collections::BTreeMap;
use std::ops::Add;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use tokio::sync::watch;
use tokio::task::{JoinError, JoinSet};

/// Pause before a failed work begins again.
const AGAIN: Duration = Duration::from_secs(10);

/// Description of a wanted work. A running work goes on while its plan equals the wanted plan of
/// its key.
pub trait Plan: PartialEq {
    /// The plan's key: at most one work runs for each key.
    type Key: Ord + Clone + Send + 'static;
    type Work: Work;

    fn key(&self) -> Self::Key;
}

/// The work that runs for a plan.
pub trait Work: Send + Sync + 'static {
    /// The statistics of the work.
    type Stats;

    fn stats(&self) -> Self::Stats;

    /// Looks at what the work waits for. It is called once a second.
    fn look(&self, _: Instant) {}

    /// Logs and shows a failure. The manager begins the work again after a while.
    fn failed(&self, why: &str);

    /// Runs until `stop` completes, and then leaves the graph and the fabric in order.
    fn run(&self, stop: impl Future<Output = ()> + Send) -> impl Future<Output = Result<(), Failure>> + Send;
}

/// Reasons for which a work ends by itself.
#[derive(Debug)]
pub enum Failure {
    /// The error may pass: the manager tries again.
    Passing(String),
    /// Only a restart of the proxy can fix the error.
    Final(anyhow::Error),
}

/// Creates the work of a plan.
type Begin<P> = Box<dyn Fn(&P) -> <P as Plan>::Work>;

/// Runs at most one work for each key, and begins its successor when it has ended.
pub struct Manager<P: Plan> {
    begin: Begin<P>,
    keys: BTreeMap<P::Key, RunningPlan<P>>,
    tasks: JoinSet<(P::Key, Option<anyhow::Error>)>,
}

struct RunningPlan<P: Plan> {
    plan: P,
    work: Arc<P::Work>,
    stop: watch::Sender<bool>,
    /// The plan that begins once this one has ended.
    next: Option<P>,
}

/// Numbers of plans that a new set of plans begins, ends and leaves unchanged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChangeCounts {
    pub begun: usize,
    pub ended: usize,
    pub unchanged: usize,
}

impl Add for ChangeCounts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            begun: self.begun + other.begun,
            ended: self.ended + other.ended,
            unchanged: self.unchanged + other.unchanged,
        }
    }
}

impl<P: Plan> Manager<P> {
    /// `begin` creates the work of a plan. The manager runs it later.
    pub fn new(begin: impl Fn(&P) -> P::Work + 'static) -> Self {
        Self { begin: Box::new(begin), keys: BTreeMap::new(), tasks: JoinSet::new() }
    }

    /// Begins and ends works until exactly these plans run, at most one for each key.
    pub fn want(&mut self, plans: impl IntoIterator<Item = P>) -> ChangeCounts {
        let mut wanted: BTreeMap<P::Key, P> = plans.into_iter().map(|plan| (plan.key(), plan)).collect();
        let mut changed = ChangeCounts::default();
        for (key, running) in &mut self.keys {
            let next = wanted.remove(key);
            let stopping = *running.stop.borrow();
            if !stopping && next.as_ref() == Some(&running.plan) {
                changed.unchanged += 1;
                continue;
            }
            changed.begun += usize::from(next.is_some());
            changed.ended += usize::from(!stopping);
            running.next = next;
            running.stop.send_replace(true);
        }
        changed.begun += wanted.len();
        for plan in wanted.into_values() {
            self.begin(plan);
        }
        changed
    }

    /// Waits for the first failure that only a restart can fix. It must be polled for works to
    /// follow one another. Safe to cancel.
    pub async fn failed(&mut self) -> anyhow::Error {
        loop {
            match self.tasks.join_next().await {
                Some(ended) => {
                    if let Some(error) = self.ended(ended) {
                        return error;
                    }
                }
                // Callers cancel this before they want something else.
                None => std::future::pending().await,
            }
        }
    }

    /// Returns the statistics of all running works, in the order of their keys.
    pub fn stats(&self) -> Vec<<P::Work as Work>::Stats> {
        self.keys.values().map(|running| running.work.stats()).collect()
    }

    /// Lets all running works look at what they wait for.
    pub fn look(&self, now: Instant) {
        self.keys.values().for_each(|running| running.work.look(now));
    }

    /// Ends all works. Returns their last statistics once they have ended.
    pub async fn close(mut self) -> Vec<<P::Work as Work>::Stats> {
        self.want([]);
        let works: Vec<_> = self.keys.values().map(|running| running.work.clone()).collect();
        while let Some(ended) = self.tasks.join_next().await {
            if let Some(error) = self.ended(ended) {
                tracing::warn!("while leaving: {error:#}");
            }
        }
        works.iter().map(|work| work.stats()).collect()
    }

    fn ended(&mut self, ended: Result<(P::Key, Option<anyhow::Error>), JoinError>) -> Option<anyhow::Error> {
        match ended.context("a route panicked") {
            Ok((key, error)) => {
                let next = self.keys.remove(&key).and_then(|running| running.next);
                next.into_iter().for_each(|plan| self.begin(plan));
                error
            }
            Err(panic) => Some(panic),
        }
    }

    fn begin(&mut self, plan: P) {
        let (key, work) = (plan.key(), Arc::new((self.begin)(&plan)));
        let (stop, stopped) = watch::channel(false);
        self.keys.insert(key.clone(), RunningPlan { plan, work: work.clone(), stop, next: None });
        self.tasks.spawn(async move { (key, run(&*work, stopped).await) });
    }
}

/// Runs the work until it is stopped or fails for good. It retries other failures.
async fn run(work: &impl Work, stopped: watch::Receiver<bool>) -> Option<anyhow::Error> {
    let stop = || {
        let mut stopped = stopped.clone();
        async move { _ = stopped.wait_for(|stopped| *stopped).await }
    };
    loop {
        match work.run(stop()).await {
            Ok(()) => return None,
            Err(Failure::Final(error)) => return Some(error),
            Err(Failure::Passing(why)) => work.failed(&why),
        }
        tokio::select! {
            () = stop() => return None,
            () = tokio::time::sleep(AGAIN) => {}
        }
    }
}

#[cfg(test)]
#[path = "../tests/unit/manager.rs"]
mod tests;
