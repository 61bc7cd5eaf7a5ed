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

use gdp::Node;
use gdp_ros::types::Types;

use crate::config::{CallConfig, What};
use crate::graph::Graph;
use crate::material::{Permission, RouteMaterial};
use crate::ros2::TopicName;
use crate::routes::Carries;
use crate::standing::{Right, RouteError, Standing};
use crate::tally::Reason as _;
use counters::CallCounters;
pub use counters::{CallStats, Reason};

/// Calls of one service or action that wait for their answers. Another one is refused.
const MAX_PENDING: usize = 1024;

pub struct Route {
    config: CallConfig,
    graph: String,
    types: Arc<Types>,
    counters: CallCounters,
    standing: Standing,
}

impl Carries for Route {
    type Config = CallConfig;
    type Key = (What, TopicName);
    type Stats = CallStats;

    fn key(config: &CallConfig) -> Self::Key {
        (config.what, config.name.clone())
    }

    fn new(config: &CallConfig, graph: &str, material: &RouteMaterial, types: Arc<Types>) -> Self {
        let title = format!("{} {}", config.what.as_str(), config.name);
        let kind = material.kind.as_ref().map(ToString::to_string);
        Self {
            config: config.clone(),
            graph: graph.into(),
            types,
            counters: CallCounters::default(),
            standing: Standing::new(title, material.card.name(), kind),
        }
    }

    fn standing(&self) -> &Standing {
        &self.standing
    }

    fn stats(&self) -> CallStats {
        CallStats {
            what: self.config.what,
            service: self.config.name.to_string(),
            graph: self.graph.clone(),
            kind: self.standing.kind(),
            status: self.standing.status(),
            direction: self.config.side,
            name: self.standing.name(),
            counted: self.counters.read(),
        }
    }

    async fn run(
        &self,
        graph: &Graph,
        node: &Node,
        material: RouteMaterial,
        stop: impl Future<Output = ()>,
    ) -> Result<(), RouteError> {
        let RouteMaterial { card, kind, permission, file } = material;
        let carry = async {
            match permission {
                Permission::Publish(cert) => {
                    self.run_out(graph, node, kind.as_ref(), &card, Right::publish(cert, file)).await
                }
                Permission::Read(grant) => {
                    self.run_in(graph, node, kind.as_ref(), &card, Right::read(grant, file)).await
                }
            }
        };
        tokio::select! {
            ended = carry => ended.map(|never: Infallible| match never {}),
            () = stop => Ok(()),
        }
    }
}

impl Route {
    /// Counts every failure; the first one for a reason is worth a line in the log, the counters have the rest.
    fn failed(&self, reason: Reason, why: impl Display) {
        if self.counters.failed(reason) {
            tracing::warn!(service = %self.config.name, reason = reason.as_str(), "a call has failed: {why}");
        }
    }

    fn is_up(&self, kind: &str) {
        self.standing.set_kind(kind);
        self.standing.is_up();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
