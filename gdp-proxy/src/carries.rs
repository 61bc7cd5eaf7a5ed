//! The trait of everything that a route manager runs.

use crate::graph::Graph;
use crate::peer_proxies::Candidate;
use crate::ros2::TypeName;
use crate::route_material::RouteMaterial;
use crate::route_status::{RouteError, RouteStatus};
use gdp::Node;
use gdp_core::card::NameCard;
use gdp_ros::types::Types;
use std::sync::Arc;

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

    fn route_status(&self) -> &RouteStatus;

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
    pub candidate: &'a Candidate,
}
