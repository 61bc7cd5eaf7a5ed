//! One topic in one direction. Each route is a task of its own; [`offload`](crate::offload) keeps
//! long work from blocking the others. Small messages that need no conversion pass the task by
//! ([`direct`]). A route whose certificate is no longer valid
//! retries, and the other routes go on.

mod direct;
mod format;
mod inward;
mod local;
mod locals;
mod outward;
mod pace;
mod pending_match;

use std::convert::Infallible;
use std::fmt::Display;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Duration;

use gdp::unstable::{Node, NodeError, Publisher};
use parking_lot::{Mutex, MutexGuard};

use crate::carries::{Carries, Way};
use crate::config::{Side, Thing, TopicConfig};
use crate::graph::{Graph, TopicUse};
use crate::peer_proxies::Candidate;
use crate::ros2::TopicName;
use crate::route_material::RouteMaterial;
use crate::route_status::{EitherRight, Right, RouteError, RouteStatus};
use crate::stats::{Drop, FabricCounters, RouteCounters, RouteStats};
use crate::tally::Reason as _;
use crate::turns::Turns;
use crate::waiting::{TopicEnds, Waiting};
use gdp_ros::roster::ROSTER;
use gdp_ros::types::Types;
use gdp_util::backoff::Backoff;
use gdp_wire::Name;

/// Time for which an ending route waits for the delivery of its last messages.
const FLUSH: Duration = Duration::from_secs(3);

pub struct Route {
    config: TopicConfig,
    graph: String,
    side: Side,
    types: Arc<Types>,
    counters: Arc<RouteCounters>,
    route_status: RouteStatus,
    /// `in`: the publishers in the fabric that have a local writer or are to have one.
    publishers_elsewhere: AtomicUsize,
    /// The counters of the route's publisher or subscription in the fabric.
    fabric: Mutex<FabricCounters>,
}

/// A published name.
struct Published {
    publisher: Publisher,
    /// The roster without publishers, which announces that they have left.
    farewell: Vec<u8>,
}

impl Carries for Route {
    type Config = TopicConfig;
    /// The local topic, and the name if it merges with others.
    type Key = (TopicName, Option<Name>);
    type Stats = RouteStats;

    fn key(config: &TopicConfig) -> Self::Key {
        (config.topic.clone(), config.merged)
    }

    fn title(config: &TopicConfig) -> String {
        Thing::Topic.title(&config.topic)
    }

    fn new(config: &TopicConfig, graph: &str, material: &RouteMaterial, types: Arc<Types>) -> Self {
        let kind = material.kind.as_ref().map(ToString::to_string);
        Self {
            config: config.clone(),
            graph: graph.into(),
            side: material.permission.side(),
            types,
            counters: Arc::default(),
            route_status: RouteStatus::new(
                Self::title(config),
                material.card.name(),
                kind,
                material.permission.until(),
            ),
            publishers_elsewhere: AtomicUsize::new(0),
            fabric: Mutex::new(FabricCounters::None),
        }
    }

    fn route_status(&self) -> &RouteStatus {
        &self.route_status
    }

    fn stats(&self) -> RouteStats {
        RouteStats {
            topic: self.config.topic.to_string(),
            graph: self.graph.clone(),
            kind: self.route_status.kind(),
            status: self.route_status.status(),
            waiting_for: self.route_status.waiting_for(),
            certificate_until: self.route_status.certificate_until(),
            direction: self.side,
            name: self.route_status.name(),
            fabric: self.fabric().read(),
            counted: self.counters.read(),
        }
    }

    fn waits_for(&self, graph: &Graph) -> Option<Waiting> {
        let TopicUse { is_published, is_subscribed } = TopicUse::of(graph, &self.config.topic);
        match (self.side, &*self.fabric()) {
            (Side::Out, FabricCounters::Out(of)) => {
                TopicEnds { local: is_published, remote: Some(of.read().readers) }.outward()
            }
            (Side::Out, _) => TopicEnds { local: is_published, remote: None }.outward(),
            (Side::In, FabricCounters::In(_)) => {
                let remote = Some(self.publishers_elsewhere.load(Relaxed));
                TopicEnds { local: is_subscribed, remote }.inward()
            }
            (Side::In, _) => None,
        }
    }

    async fn run(
        &self,
        graph: &Graph,
        node: &Node,
        material: RouteMaterial,
        stop: impl Future<Output = ()> + Send,
    ) -> Result<(), RouteError> {
        // A route that has failed leaves the topic to other proxies until it works again.
        let candidate =
            graph.peer_proxies().enter(node.name(), self.route_status.part(self.side), !self.route_status.has_failed());
        let RouteMaterial { card, kind, permission, file } = material;
        let way = Way { graph, node, kind: kind.as_ref(), card: &card, candidate: &candidate };
        let mut right = EitherRight::new(permission, file);
        let mut publisher = None;
        let mut stop = pin!(stop);
        let mut turns = Turns::new(&candidate, node, &self.route_status, stop.as_mut());
        while turns.begin().await {
            let result = tokio::select! {
                Err(error) = self.carry(&way, &mut right, &mut publisher) => Err(error),
                () = turns.over() => Ok(()),
            };
            if let Some(publisher) = publisher.take() {
                self.close(publisher).await;
            }
            result?;
        }
        Ok(())
    }
}

impl Route {
    async fn carry(
        &self,
        way: &Way<'_>,
        right: &mut EitherRight,
        publisher: &mut Option<Published>,
    ) -> Result<Infallible, RouteError> {
        match right {
            EitherRight::Publish(right) => self.run_out(way, right, publisher).await,
            EitherRight::Read(right) => self.run_in(way, right).await,
        }
    }

    /// Announces to the readers that the publishers are no longer carried, delivers the sent
    /// messages, and closes the publisher.
    async fn close(&self, Published { publisher, farewell }: Published) {
        publisher.pin(ROSTER, &farewell);
        if let Err(error) = publisher.close(FLUSH).await {
            tracing::warn!(topic = %self.config.topic, name = %self.route_status.name(), "left with messages under way: {error}");
        }
    }

    /// Waits after a refusal. Meanwhile another proxy of the graph may carry the topic.
    async fn pause<T: Clone>(
        &self,
        error: NodeError,
        pause: &mut Backoff,
        right: &mut Right<T>,
        candidate: &Candidate,
    ) {
        candidate.set_permitted(false);
        self.route_status.pause(error, pause, right).await;
    }

    /// Counts a drop and logs the first one for each reason.
    fn drop(&self, reason: Drop, why: impl Display) {
        self.drop_all(reason, 1, why);
    }

    fn drop_all(&self, reason: Drop, count: u64, why: impl Display) {
        if count > 0 && self.counters.dropped(reason, count) {
            tracing::warn!(topic = %self.config.topic, reason = reason.as_str(), "a message was dropped: {why}");
        }
    }

    fn fabric(&self) -> MutexGuard<'_, FabricCounters> {
        self.fabric.lock()
    }

    fn is_up(&self, candidate: &Candidate) {
        candidate.set_permitted(true);
        self.route_status.is_up();
    }
}
