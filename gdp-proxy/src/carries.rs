//! The trait of everything that a route manager runs.

use crate::graph::Graph;
use crate::peer_proxies::Candidate;
use crate::ros2::TypeName;
use crate::route_material::RouteMaterial;
use crate::route_status::{RouteError, RouteStatus};
use crate::waiting::Waiting;
use gdp::unstable::Node;
use gdp_core::card::NameCard;
use gdp_ros::types::Types;
use std::sync::Arc;

/// A route that carries one topic, service or action in one direction.
pub trait Carries: Send + Sync + 'static {
    /// The route's configuration.
    type Config: PartialEq + Send + Sync + 'static;
    /// The route's key, unique among the routes of its kind and direction in a graph.
    type Key: Ord + Clone + Send + 'static;
    /// The route's statistics.
    type Stats;

    fn key(config: &Self::Config) -> Self::Key;

    /// The route's title in the log.
    fn title(config: &Self::Config) -> String;

    /// Creates a route that does not run yet. `graph` is the graph's name in the configuration.
    fn new(config: &Self::Config, graph: &str, material: &RouteMaterial, types: Arc<Types>) -> Self;

    fn route_status(&self) -> &RouteStatus;

    fn stats(&self) -> Self::Stats;

    /// Returns what is missing for messages to flow while the route is attached and permitted.
    fn waits_for(&self, graph: &Graph) -> Option<Waiting>;

    /// Runs the route until `stop` completes, the graph fails or the node is closed. It delivers
    /// what it has sent by then, if it can.
    fn run(
        &self,
        graph: &Graph,
        node: &Node,
        material: RouteMaterial,
        stop: impl Future<Output = ()> + Send,
    ) -> impl Future<Output = Result<(), RouteError>> + Send;
}

/// The two ends of a route, and what it carries between them.
pub struct Way<'a> {
    pub graph: &'a Graph,
    pub node: &'a Node,
    /// The type, from the name card or the configuration.
    pub kind: Option<&'a TypeName>,
    pub card: &'a NameCard,
    pub candidate: &'a Candidate,
}
