//! Reconciles the wanted plans with the running ones. The manager begins new plans, ends unwanted
//! ones, and leaves unchanged ones alone.
//!
//! A [`Plan`] says what is to run and where; a [`Work`] is what runs then, as a task. In one place
//! runs one work at a time: another one begins there when the one before has ended. What fails is
//! begun again, because ROS graphs mend; what only a new start of the proxy can mend is returned by
//! [`Manager::failed`].

use std::collections::BTreeMap;
use std::ops::Add;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use tokio::sync::watch;
use tokio::task::{JoinError, JoinSet};

/// Before what failed is begun again.
const AGAIN: Duration = Duration::from_secs(10);

/// Something that is wanted. While it equals what runs in its place, that goes on.
pub trait Plan: PartialEq {
    /// Where it is: of one place one runs at a time.
    type Key: Ord + Clone + Send + 'static;
    type Work: Work;

    fn key(&self) -> Self::Key;
}

/// What runs for a plan.
pub trait Work: Send + Sync + 'static {
    /// What is shown of it.
    type Stats;

    fn stats(&self) -> Self::Stats;

    /// It has failed, and is begun again after a while: shown and said in the log.
    fn failed(&self, why: &str);

    /// Runs until `stop` ends, and leaves both sides properly then.
    fn run(&self, stop: impl Future<Output = ()> + Send) -> impl Future<Output = Result<(), Failure>> + Send;
}

/// Why a work ended by itself.
#[derive(Debug)]
pub enum Failure {
    /// It may be otherwise next time.
    Passing(String),
    /// Only a new start of the proxy can mend it.
    Final(anyhow::Error),
}

/// Makes what runs for a plan.
type Begin<P> = Box<dyn Fn(&P) -> <P as Plan>::Work>;

/// What runs, and what is to run in its place.
pub struct Manager<P: Plan> {
    begin: Begin<P>,
    keys: BTreeMap<P::Key, RunningPlan<P>>,
    tasks: JoinSet<(P::Key, Option<anyhow::Error>)>,
}

struct RunningPlan<P: Plan> {
    plan: P,
    work: Arc<P::Work>,
    stop: watch::Sender<bool>,
    /// Once this has ended.
    next: Option<P>,
}

/// What came of a set of plans, by count.
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
    /// `begin` makes what runs for a plan; it runs later.
    pub fn new(begin: impl Fn(&P) -> P::Work + 'static) -> Self {
        Self { begin: Box::new(begin), keys: BTreeMap::new(), tasks: JoinSet::new() }
    }

    /// From now on these run, at most one in a place, and no others.
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

    /// The first failure that only a new start can mend; waits until there is one. It must be
    /// polled for works to follow one another, and is safe to cancel.
    pub async fn failed(&mut self) -> anyhow::Error {
        loop {
            match self.tasks.join_next().await {
                Some(ended) => {
                    if let Some(error) = self.ended(ended) {
                        return error;
                    }
                }
                // Whoever wants something cancels this first.
                None => std::future::pending().await,
            }
        }
    }

    /// Of all that run, in the order of their places.
    pub fn stats(&self) -> Vec<<P::Work as Work>::Stats> {
        self.keys.values().map(|running| running.work.stats()).collect()
    }

    /// Ends all, and returns when they have ended, with what is to be shown of them at last.
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

/// Until it is stopped, or fails for good.
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
