//! The routes of topics, services and actions, as plans of the [manager](crate::manager).

pub use crate::carries::{Carries, Way};
use std::sync::Arc;
use std::time::Instant;

use gdp::unstable::Node;
use gdp_ros::types::Types;

use crate::config::Side;
use crate::graph::{Graph, names_in};
use crate::manager::{Failure, Manager, Plan, Work};
use crate::route_material::RouteMaterial;
use crate::waiting::Waiting;
use crate::{call, route};

/// Maximum number of names in the log line of a route that waits.
const MAX_SEEN: usize = 8;

pub type Routes = Manager<Arc<RoutePlan>>;
pub type Calls = Manager<Arc<CallPlan>>;

/// A topic in one direction, with everything that its route needs.
pub type RoutePlan = Planned<route::Route>;
/// A service or an action in one direction, with everything that its route needs.
pub type CallPlan = Planned<call::Route>;

/// A route in one direction, with everything that it needs.
pub struct Planned<R: Carries> {
    pub config: R::Config,
    /// The graph's name in the configuration.
    pub label: String,
    pub graph: Arc<Graph>,
    pub material: RouteMaterial,
}

/// The running route of a plan.
pub struct RunningRoute<R: Carries> {
    route: R,
    plan: Arc<Planned<R>>,
    node: Node,
}

/// Creates a manager whose routes use `node` and `types`.
pub fn manager<R: Carries>(node: Node, types: Arc<Types>) -> Manager<Arc<Planned<R>>> {
    Manager::new(move |plan: &Arc<Planned<R>>| {
        let route = R::new(&plan.config, &plan.label, &plan.material, types.clone());
        RunningRoute { route, plan: plan.clone(), node: node.clone() }
    })
}

/// Plans are equal although their certificates differ. Routes watch the file or issuer of their
/// certificate themselves, so a renewed certificate starts no new route.
impl<R: Carries> PartialEq for Planned<R> {
    fn eq(&self, other: &Self) -> bool {
        let (own, others) = (&self.material, &other.material);
        Arc::ptr_eq(&self.graph, &other.graph)
            && self.config == other.config
            && self.label == other.label
            && (own.permission.side(), &own.card, &own.kind) == (others.permission.side(), &others.card, &others.kind)
    }
}

impl<R: Carries> Plan for Arc<Planned<R>> {
    type Key = (String, R::Key, Side);
    type Work = RunningRoute<R>;

    fn key(&self) -> Self::Key {
        (self.label.clone(), R::key(&self.config), self.material.permission.side())
    }
}

impl<R: Carries> Work for RunningRoute<R> {
    type Stats = R::Stats;

    fn stats(&self) -> R::Stats {
        self.route.stats()
    }

    fn look(&self, now: Instant) {
        let graph = &self.plan.graph;
        let waits_for = || self.route.waits_for(graph);
        self.route.route_status().look(now, self.node.switch().is_ok(), waits_for, |waiting| detail(waiting, graph));
    }

    fn failed(&self, why: &str) {
        self.route.route_status().failed(why);
    }

    async fn run(&self, stop: impl Future<Output = ()> + Send) -> Result<(), Failure> {
        let Planned { graph, material, .. } = &*self.plan;
        let ended = self.route.run(graph, &self.node, material.clone(), stop).await;
        ended.map_err(|error| self.route.route_status().ended(error))
    }
}

/// Says where a route waits, and for a publisher or server what is there instead.
fn detail(waiting: Waiting, graph: &Graph) -> String {
    if !waiting.is_local() {
        return String::new();
    }
    let graph_name = format!(" in {}", graph.describe());
    let kind = match waiting {
        Waiting::LocalPublisher => "topic is published",
        Waiting::LocalServer => "service or action is served",
        _ => return graph_name,
    };
    match names_in(graph, waiting == Waiting::LocalServer, MAX_SEEN) {
        (names, _) if names.is_empty() => format!("{graph_name}; no {kind} there"),
        (names, 0) => format!("{graph_name}; seen there: {}", names.join(", ")),
        (names, more) => format!("{graph_name}; seen there: {}, and {more} more", names.join(", ")),
    }
}
