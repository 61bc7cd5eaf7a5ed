//! One service or action in one direction: local servers for remote clients ([`outward`]), or
//! remote servers for local clients ([`inward`]). Each is a task of its own. A call waits for its
//! answer within the task and blocks nobody.
//!
//! Neither side has a timeout for calls. A call ends with its answer, with its server, or when the
//! client cancels it or leaves. Only one proxy of a graph takes calls. When it stops, it sends
//! failures to the waiting clients, as far as their ROS version can express them.

mod asking;
mod backend;
mod copies;
mod counters;
mod inward;
pub mod material;
mod outbox;
mod outward;
mod running;
mod stand;

use std::fmt::Display;
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp::unstable::Node;
use gdp_ros::types::Types;
use parking_lot::Mutex;

use crate::carries::{Carries, Way};
use crate::config::{CallConfig, Thing, What};
use crate::graph::Graph;
use crate::peer_proxies::LISTEN;
use crate::ros2::TopicName;
use crate::route_material::RouteMaterial;
use crate::route_status::{EitherRight, RouteError, RouteStatus};
use crate::tally::Reason as _;
use crate::turns::{Turns, unless};
use crate::waiting::Waiting;
use counters::CallCounters;
pub use counters::{CallStats, Reason};

/// Bound on the pending calls of one service or action. Further calls are refused.
const MAX_PENDING: usize = 1024;

/// Time to send failures to the clients of pending calls at the end of a route.
const LAST_WORDS: Duration = Duration::from_secs(1);

pub struct Route {
    config: CallConfig,
    graph: String,
    types: Arc<Types>,
    counters: CallCounters,
    route_status: RouteStatus,
    /// Until then the route leaves the name to other proxies, because it could not call any remote
    /// server.
    unfit_until: Mutex<Option<Instant>>,
}

impl Carries for Route {
    type Config = CallConfig;
    type Key = (What, TopicName);
    type Stats = CallStats;

    fn key(config: &CallConfig) -> Self::Key {
        (config.what, config.name.clone())
    }

    fn title(config: &CallConfig) -> String {
        Thing::Call(config.what).title(&config.name)
    }

    fn new(config: &CallConfig, graph: &str, material: &RouteMaterial, types: Arc<Types>) -> Self {
        let kind = material.kind.as_ref().map(ToString::to_string);
        Self {
            config: config.clone(),
            graph: graph.into(),
            types,
            counters: CallCounters::default(),
            route_status: RouteStatus::new(
                Self::title(config),
                material.card.name(),
                kind,
                material.permission.until(),
            ),
            unfit_until: Mutex::new(None),
        }
    }

    fn route_status(&self) -> &RouteStatus {
        &self.route_status
    }

    fn stats(&self) -> CallStats {
        CallStats {
            what: self.config.what,
            service: self.config.name.to_string(),
            graph: self.graph.clone(),
            kind: self.route_status.kind(),
            status: self.route_status.status(),
            waiting_for: self.route_status.waiting_for(),
            certificate_until: self.route_status.certificate_until(),
            direction: self.config.side,
            name: self.route_status.name(),
            counted: self.counters.read(),
        }
    }

    fn waits_for(&self, _: &Graph) -> Option<Waiting> {
        let status = self.route_status.status();
        [Waiting::LocalServer, Waiting::RemoteServer].into_iter().find(|waiting| waiting.as_str() == status)
    }

    async fn run(
        &self,
        graph: &Graph,
        node: &Node,
        material: RouteMaterial,
        stop: impl Future<Output = ()> + Send,
    ) -> Result<(), RouteError> {
        let RouteMaterial { card, kind, permission, file } = material;
        // A route that has failed leaves the name to other proxies until it works again.
        let candidate = graph.peer_proxies().enter(
            node.name(),
            self.route_status.part(permission.side()),
            !self.route_status.has_failed(),
        );
        let way = Way { graph, node, kind: kind.as_ref(), card: &card, candidate: &candidate };
        let (mut right, mut stop) = (EitherRight::new(permission, file), pin!(stop));
        // A call that two proxies execute does harm.
        self.route_status.set_status("listening for other proxies of the graph");
        if unless(&mut stop, tokio::time::sleep(LISTEN)).await.is_none() {
            return Ok(());
        }
        let mut turns = Turns::new(&candidate, node, &self.route_status, stop);
        while turns.begin().await {
            candidate.set_keeps(true);
            let over = pin!(turns.over());
            let ended = match &mut right {
                EitherRight::Publish(right) => self.run_out(&way, right, over).await,
                EitherRight::Read(right) => self.run_in(&way, right, over).await,
            };
            self.counters.servers(0);
            candidate.set_keeps(false);
            ended?;
        }
        Ok(())
    }
}

impl Route {
    /// Counts a failed call and logs the first one for each reason.
    fn failed(&self, reason: Reason, why: impl Display) {
        if self.counters.failed(reason) {
            tracing::warn!(service = %self.config.name, reason = reason.as_str(), "a call has failed: {why}");
        }
    }

    /// Whether this proxy leaves the name to others, because it could not call any remote server
    /// lately.
    fn leaves_to_others(&self, now: Instant) -> bool {
        self.unfit_until.lock().is_some_and(|until| now < until)
    }

    fn is_up(&self, kind: &str) {
        self.route_status.set_kind(kind);
        self.route_status.is_up();
    }
}
