//! One topic in one direction. Each route has a thread of its own, so a slow topic holds up nobody else's; within it a
//! message goes straight from one side to the other, without a queue or a wake-up in between. A topic whose right has ended is
//! asked for again and again, and the others go on.

mod hold;
mod inward;
mod local;
mod locals;
mod outward;
mod pace;

use std::convert::Infallible;
use std::fmt::Display;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use gdp::node::{Ended, NodeError, Publisher};
use gdp::{Name, NameCard, Node};
use tokio::time::{Interval, MissedTickBehavior};

use crate::config::{Side, TopicConfig};
use crate::graph::{Graph, GraphError};
use crate::material::{Permission, RouteMaterial};
use crate::renewal::Renewal;
use crate::ros2::TypeName;
use crate::stats::{Drop, FabricCounters, RouteCounters, RouteStats};
use crate::twins::{Part, Place};
use gdp_ros::roster::ROSTER;
use gdp_ros::types::Types;

/// Between attempts to have a name published or subscribed: doubled from the first to the second.
const RETRY: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(30));

/// How often it is looked for another certificate, and whether a roster is due.
const LOOK: Duration = Duration::from_secs(1);

/// How often it is looked whether another proxy of the graph carries the topic.
const LOOK_FOR_TWINS: Duration = Duration::from_millis(250);

/// How long a route that ends waits for what it has sent to arrive.
const FLUSH: Duration = Duration::from_secs(3);

pub struct Route {
    config: TopicConfig,
    graph: String,
    side: Side,
    name: Name,
    types: Arc<Types>,
    counters: RouteCounters,
    progress: Mutex<Progress>,
    /// It has ended by itself before.
    has_failed: AtomicBool,
}

/// From where to where, and as what.
struct Way<'a> {
    graph: &'a Graph,
    node: &'a Node,
    /// Of the name's card or the configuration.
    kind: Option<&'a TypeName>,
    card: &'a NameCard,
    place: &'a Place,
}

enum Right {
    Publish(outward::Right),
    Read(inward::Right),
}

impl Right {
    fn new(permission: Permission, file: Renewal) -> Self {
        match permission {
            Permission::Publish(cert) => Self::Publish(outward::Right { cert, file }),
            Permission::Read(grant) => Self::Read(inward::Right { grant, file }),
        }
    }
}

/// Waits for what is wanted of who carries a topic instead of this proxy; and tells meanwhile whether this one could.
async fn until<T>(node: &Node, place: &Place, wanted: impl Fn(Option<Name>) -> Option<T>) -> T {
    loop {
        place.set_attached(node.switch().is_ok());
        if let Some(found) = wanted(place.ahead(Instant::now())) {
            return found;
        }
        tokio::time::sleep(LOOK_FOR_TWINS).await;
    }
}

/// A name that is published.
struct Published {
    publisher: Publisher,
    /// The roster of nobody.
    farewell: Vec<u8>,
}

/// How far a route has come, for people and tests.
struct Progress {
    kind: Option<String>,
    status: String,
    fabric: FabricCounters,
}

impl Route {
    /// `graph`: what the configuration calls it.
    pub fn new(config: &TopicConfig, graph: &str, material: &RouteMaterial, types: Arc<Types>) -> Self {
        Self {
            config: config.clone(),
            graph: graph.into(),
            side: material.side,
            name: material.card.name(),
            types,
            counters: RouteCounters::default(),
            progress: Mutex::new(Progress {
                kind: material.kind.as_ref().map(ToString::to_string),
                status: "starting".into(),
                fabric: FabricCounters::None,
            }),
            has_failed: AtomicBool::new(false),
        }
    }

    pub fn stats(&self) -> RouteStats {
        let progress = self.progress();
        RouteStats {
            topic: self.config.topic.to_string(),
            graph: self.graph.clone(),
            kind: progress.kind.clone(),
            status: progress.status.clone(),
            direction: self.side,
            name: self.name,
            fabric: progress.fabric.read(),
            counted: self.counters.read(),
        }
    }

    /// Carries messages until `stop` ends, or the graph fails or the node is closed. What has been sent by then arrives, if it can.
    pub async fn run(
        &self,
        graph: &Graph,
        node: &Node,
        material: RouteMaterial,
        stop: impl Future<Output = ()>,
    ) -> Result<(), RouteError> {
        let mut publisher = None;
        let result = tokio::select! {
            Err(error) = self.carry(graph, node, material, &mut publisher) => Err(error),
            () = stop => Ok(()),
        };
        if let Some(publisher) = publisher {
            self.close(publisher).await;
        }
        result
    }

    async fn carry(
        &self,
        graph: &Graph,
        node: &Node,
        material: RouteMaterial,
        publisher: &mut Option<Published>,
    ) -> Result<Infallible, RouteError> {
        let part = Part { name: self.name, side: self.side, topic: self.config.topic.to_string() };
        // What has failed is left to others until it shows that it works by now.
        let place = graph.twins().enter(node.name(), part, !self.has_failed.load(Relaxed));
        let RouteMaterial { card, kind, permission, file, .. } = material;
        let way = Way { graph, node, kind: kind.as_ref(), card: &card, place: &place };
        let mut right = Right::new(permission, file);
        loop {
            let ahead = tokio::select! {
                Err(error) = self.carry_as_first(&way, &mut right, publisher) => return Err(error),
                ahead = until(node, &place, |ahead| ahead) => ahead,
            };
            if let Some(publisher) = publisher.take() {
                self.close(publisher).await;
            }
            tracing::info!(topic = %self.config.topic, side = ?self.side, name = %self.name, "standing by for {ahead}");
            self.set_status(&format!("standing by for {ahead}"));
            until(node, &place, |ahead| ahead.is_none().then_some(())).await;
        }
    }

    async fn carry_as_first(
        &self,
        way: &Way<'_>,
        right: &mut Right,
        publisher: &mut Option<Published>,
    ) -> Result<Infallible, RouteError> {
        match right {
            Right::Publish(right) => self.run_out(way, right, publisher).await,
            Right::Read(right) => self.run_in(way, right).await,
        }
    }

    /// Those who read the name hear that its publishers are not carried any more, and need not miss them.
    async fn close(&self, Published { publisher, farewell }: Published) {
        publisher.pin(ROSTER, &farewell);
        if let Err(error) = publisher.close(FLUSH).await {
            tracing::warn!(topic = %self.config.topic, name = %self.name, "left with messages under way: {error}");
        }
    }

    /// What came of showing the RIB another certificate. Whether it is in force.
    fn renewed(&self, file: &mut Renewal, result: Result<(), NodeError>) -> bool {
        match &result {
            Ok(()) => {
                file.taken();
                tracing::info!(topic = %self.config.topic, name = %self.name, "the certificate was renewed");
            }
            Err(error) => file.refused(error),
        }
        result.is_ok()
    }

    /// A refusal is no reason to end: other topics may be fine, and owners, RIBs and clocks mend.
    async fn pause_after(&self, error: NodeError, pause: &mut Duration, place: &Place) {
        place.set_permitted(false);
        let message = error.to_string();
        tracing::warn!(topic = %self.config.topic, name = %self.name, "{message}; asking again in {pause:?}");
        self.set_status(&message);
        tokio::time::sleep(*pause).await;
        *pause = (*pause * 2).min(RETRY.1);
    }

    /// Counts every drop; the first one for a reason is worth a line in the log, the counters have the rest.
    fn drop(&self, reason: Drop, why: impl Display) {
        self.drop_all(reason, 1, why);
    }

    fn drop_all(&self, reason: Drop, count: u64, why: impl Display) {
        if count > 0 && self.counters.dropped(reason, count) {
            tracing::warn!(topic = %self.config.topic, reason = reason.as_str(), "a message was dropped: {why}");
        }
    }

    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_up(&self, place: &Place) {
        place.set_permitted(true);
        tracing::info!(topic = %self.config.topic, side = ?self.side, name = %self.name, "carrying");
        self.set_status("up");
    }

    /// It ended by itself, and begins again after a while.
    pub fn failed(&self, why: &str) {
        self.has_failed.store(true, Relaxed);
        tracing::warn!(topic = %self.config.topic, side = ?self.side, name = %self.name, "not carried: {why}; beginning again in a while");
        self.set_status(why);
    }

    fn set_status(&self, status: &str) {
        self.progress().status = status.into();
    }
}

fn ended_because(why: Ended) -> Result<NodeError, RouteError> {
    match why {
        Ended::Right(error) => Ok(error.into()),
        Ended::Closed => Err(RouteError::NodeClosed),
    }
}

fn ticks() -> Interval {
    let mut ticks = tokio::time::interval(LOOK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

/// Why a route ended.
#[derive(Debug, thiserror::Error)]
pub enum RouteError {
    #[error(transparent)]
    Graph(#[from] GraphError),
    #[error(transparent)]
    Cbor(#[from] gdp::cbor::CborError),
    #[error("the node is closed")]
    NodeClosed,
}

impl RouteError {
    /// Whether it may be otherwise when the route begins again.
    pub fn may_pass(&self) -> bool {
        !matches!(self, Self::NodeClosed | Self::Graph(GraphError::Left))
    }
}
