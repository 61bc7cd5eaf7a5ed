//! One service or action in one direction, as `route` has topics: servers here that are called from elsewhere ([`outward`]), or servers elsewhere
//! that are called from here ([`inward`]). Each has a thread of its own; a call waits for its answer in it and holds up nobody.
//!
//! Neither side ends a call by itself, however long it takes: it ends with its answer, with its server, or when the client gives it up.

mod backend;
mod counters;
mod inward;
pub mod material;
mod outward;
mod stand;

use std::convert::Infallible;
use std::fmt::Display;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use gdp::node::{Ended, NodeError};
use gdp::{Name, Node};
use gdp_ros::types::Types;
use tokio::time::{Interval, MissedTickBehavior};

use crate::cert_file::CertFile;
use crate::config::CallConfig;
use crate::graph::{Graph, GraphError};
use crate::material::Permission;
use counters::CallCounters;
pub use counters::{CallStats, Reason};
use material::CallMaterial;

/// Between attempts to have a name served or called: doubled from the first to the second.
const RETRY: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(30));

/// How often it is looked for another certificate, and for what is over.
const LOOK: Duration = Duration::from_secs(1);

/// Calls of one service or action that wait for their answers. Another one is refused.
const MAX_PENDING: usize = 1024;

pub struct Route {
    config: CallConfig,
    graph: String,
    name: Name,
    types: Arc<Types>,
    counters: CallCounters,
    progress: Mutex<Progress>,
}

/// How far it has come, for people and tests.
struct Progress {
    kind: Option<String>,
    status: String,
}

impl Route {
    /// `graph`: what the configuration calls it.
    pub fn new(config: &CallConfig, graph: &str, material: &CallMaterial, types: Arc<Types>) -> Self {
        let kind = material.kind.as_ref().map(ToString::to_string);
        Self {
            config: config.clone(),
            graph: graph.into(),
            name: material.card.name(),
            types,
            counters: CallCounters::default(),
            progress: Mutex::new(Progress { kind, status: "starting".into() }),
        }
    }

    pub fn stats(&self) -> CallStats {
        let Progress { kind, status } = &*self.progress();
        CallStats {
            what: self.config.what,
            service: self.config.name.to_string(),
            graph: self.graph.clone(),
            kind: kind.clone(),
            status: status.clone(),
            direction: self.config.side,
            name: self.name,
            counted: self.counters.read(),
        }
    }

    /// `service /add_two_ints`
    pub fn title(&self) -> String {
        format!("{} {}", self.config.what.as_str(), self.config.name)
    }

    /// Carries calls until `stop` ends, or the graph fails or the node is closed.
    pub async fn run(
        &self,
        graph: &Graph,
        node: &Node,
        material: CallMaterial,
        stop: impl Future<Output = ()>,
    ) -> Result<(), CallError> {
        let CallMaterial { card, kind, permission, file, .. } = material;
        let carry = async {
            match permission {
                Permission::Publish(cert) => {
                    self.run_out(graph, node, kind.as_ref(), &card, outward::Right { cert, file }).await
                }
                Permission::Read(grant) => {
                    self.run_in(graph, node, kind.as_ref(), &card, inward::Right { grant, file }).await
                }
            }
        };
        tokio::select! {
            ended = carry => ended.map(|never: Infallible| match never {}),
            () = stop => Ok(()),
        }
    }

    /// What came of showing the RIB another certificate. Whether it is in force.
    fn renewed(&self, file: &mut CertFile, result: Result<(), NodeError>) -> bool {
        match &result {
            Ok(()) => {
                file.taken();
                tracing::info!(service = %self.config.name, name = %self.name, "the certificate was renewed");
            }
            Err(error) => file.refused(error),
        }
        result.is_ok()
    }

    /// A refusal is no reason to end: others may be fine, and owners, RIBs and clocks mend.
    async fn pause_after(&self, error: impl Display, pause: &mut Duration) {
        let message = error.to_string();
        tracing::warn!(service = %self.config.name, name = %self.name, "{message}; trying again in {pause:?}");
        self.set_status(&message);
        tokio::time::sleep(*pause).await;
        *pause = (*pause * 2).min(RETRY.1);
    }

    /// It ended by itself, and begins again after a while.
    pub fn ended(&self, why: &str) {
        tracing::warn!(service = %self.config.name, side = ?self.config.side, name = %self.name, "not carried: {why}; beginning again in a while");
        self.set_status(why);
    }

    /// Counts every failure; the first one for a reason is worth a line in the log, the counters have the rest.
    fn failed(&self, reason: Reason, why: impl Display) {
        if self.counters.failed(reason) {
            tracing::warn!(service = %self.config.name, reason = reason.as_str(), "a call has failed: {why}");
        }
    }

    fn progress(&self) -> MutexGuard<'_, Progress> {
        lock(&self.progress)
    }

    fn is_up(&self, kind: &str) {
        tracing::info!(service = %self.config.name, side = ?self.config.side, name = %self.name, kind, "carrying calls");
        let mut progress = self.progress();
        (progress.kind, progress.status) = (Some(kind.into()), "up".into());
    }

    fn set_status(&self, status: &str) {
        self.progress().status = status.into();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn ended_because(why: Ended) -> Result<NodeError, CallError> {
    match why {
        Ended::Right(error) => Ok(error.into()),
        Ended::Closed => Err(CallError::NodeClosed),
    }
}

fn ticks() -> Interval {
    let mut ticks = tokio::time::interval(LOOK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

/// Why no more calls are carried.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    #[error(transparent)]
    Graph(#[from] GraphError),
    #[error("the node is closed")]
    NodeClosed,
}

impl CallError {
    /// Whether it may be otherwise when the route begins again.
    pub fn may_pass(&self) -> bool {
        !matches!(self, Self::NodeClosed | Self::Graph(GraphError::Left))
    }
}
