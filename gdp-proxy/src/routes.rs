//! The routes of topics, services and actions, as the [manager](crate::manager) has them.

use std::sync::Arc;

use gdp::Node;
use gdp_core::card::NameCard;
use gdp_ros::types::Types;

use crate::config::Side;
use crate::graph::Graph;
use crate::manager::{Failure, Manager, Plan, Work};
use crate::material::RouteMaterial;
use crate::peer_proxies::Place;
use crate::ros2::TypeName;
use crate::route_status::{RouteError, RouteStatus};
use crate::{call, route};

pub type Routes = Manager<Arc<RoutePlan>>;
pub type Calls = Manager<Arc<CallPlan>>;

/// A topic in one direction, with all that its route needs.
pub type RoutePlan = Planned<route::Route>;
/// A service or an action.
pub type CallPlan = Planned<call::Route>;

/// Carries something in one direction.
pub trait Carries: Send + Sync + 'static {
    /// What is said of it.
    type Config: PartialEq + Send + Sync + 'static;
    /// What tells it apart from all others of its kind in a graph.
    type Key: Ord + Clone + Send + 'static;
    /// What is shown of it.
    type Stats;

    fn key(config: &Self::Config) -> Self::Key;

    /// What the log calls it.
    fn title(config: &Self::Config) -> String;

    /// `graph`: what the configuration calls it.
    fn new(config: &Self::Config, graph: &str, material: &RouteMaterial, types: Arc<Types>) -> Self;

    fn standing(&self) -> &RouteStatus;

    fn stats(&self) -> Self::Stats;

    /// Carries until `stop` ends, or the graph fails or the node is closed. What has been sent by
    /// then arrives, if it can.
    fn run(
        &self,
        graph: &Graph,
        node: &Node,
        material: RouteMaterial,
        stop: impl Future<Output = ()> + Send,
    ) -> impl Future<Output = Result<(), RouteError>> + Send;
}

/// From where to where, and as what.
pub struct Way<'a> {
    pub graph: &'a Graph,
    pub node: &'a Node,
    /// Of the name's card or the configuration.
    pub kind: Option<&'a TypeName>,
    pub card: &'a NameCard,
    pub place: &'a Place,
}

/// Something in one direction, with all that its route needs.
pub struct Planned<R: Carries> {
    pub config: R::Config,
    /// What the configuration calls the graph.
    pub label: String,
    pub graph: Arc<Graph>,
    pub material: RouteMaterial,
}

/// The route of a plan.
pub struct Running<R: Carries> {
    route: R,
    plan: Arc<Planned<R>>,
    node: Node,
}

/// Of a node, with these types.
pub fn manager<R: Carries>(node: Node, types: Arc<Types>) -> Manager<Arc<Planned<R>>> {
    Manager::new(move |plan: &Arc<Planned<R>>| {
        let route = R::new(&plan.config, &plan.label, &plan.material, types.clone());
        Running { route, plan: plan.clone(), node: node.clone() }
    })
}

/// What a right is comes from its file or issuer, which routes look at themselves: another right is
/// no other route.
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
    type Place = (String, R::Key, Side);
    type Work = Running<R>;

    fn place(&self) -> Self::Place {
        (self.label.clone(), R::key(&self.config), self.material.permission.side())
    }
}

impl<R: Carries> Work for Running<R> {
    type Stats = R::Stats;

    fn stats(&self) -> R::Stats {
        self.route.stats()
    }

    fn failed(&self, why: &str) {
        self.route.standing().failed(why);
    }

    async fn run(&self, stop: impl Future<Output = ()> + Send) -> Result<(), Failure> {
        let Planned { graph, material, .. } = &*self.plan;
        let ended = self.route.run(graph, &self.node, material.clone(), stop).await;
        ended.map_err(|error| self.route.standing().ended(error))
    }
}
