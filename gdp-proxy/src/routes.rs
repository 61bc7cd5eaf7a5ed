//! The routes of topics, as the [manager](crate::manager) has them.

use std::sync::Arc;

use anyhow::anyhow;
use gdp::Node;
use gdp_ros::types::Types;

use crate::config::{Side, TopicConfig};
use crate::graph::Graph;
use crate::manager::{Failure, Manager, Plan, Work};
use crate::material::RouteMaterial;
use crate::ros2::TopicName;
use crate::route::Route;
use crate::stats::RouteStats;

pub type Routes = Manager<Arc<RoutePlan>>;

/// A topic in one direction, with all that its route needs.
pub struct RoutePlan {
    pub config: TopicConfig,
    /// What the configuration calls the graph.
    pub label: String,
    pub graph: Arc<Graph>,
    pub material: RouteMaterial,
}

/// The route of a plan.
pub struct RouteWork {
    route: Route,
    plan: Arc<RoutePlan>,
    node: Node,
}

/// Of a node, with these types.
pub fn manager(node: Node, types: Arc<Types>) -> Routes {
    Manager::new(move |plan: &Arc<RoutePlan>| {
        let route = Route::new(&plan.config, &plan.label, &plan.material, types.clone());
        RouteWork { route, plan: plan.clone(), node: node.clone() }
    })
}

/// What a right is comes from its file or issuer, which routes look at themselves: another right is no other route.
impl PartialEq for RoutePlan {
    fn eq(&self, other: &Self) -> bool {
        let same = |plan: &Self| (plan.label.clone(), plan.material.side, plan.material.kind.clone());
        Arc::ptr_eq(&self.graph, &other.graph)
            && self.config == other.config
            && self.material.card == other.material.card
            && same(self) == same(other)
    }
}

impl Plan for Arc<RoutePlan> {
    type Place = (String, TopicName, Side);
    type Work = RouteWork;

    fn place(&self) -> Self::Place {
        (self.label.clone(), self.config.topic.clone(), self.material.side)
    }
}

impl Work for RouteWork {
    type Stats = RouteStats;

    fn stats(&self) -> RouteStats {
        self.route.stats()
    }

    fn failed(&self, why: &str) {
        self.route.failed(why);
    }

    async fn run(&self, stop: impl Future<Output = ()>) -> Result<(), Failure> {
        let RoutePlan { graph, material, config, .. } = &*self.plan;
        let ended = self.route.run(graph, &self.node, material.clone(), stop).await;
        ended.map_err(|error| match error.may_pass() {
            true => Failure::Passing(error.to_string()),
            false => Failure::Final(anyhow!(error).context(format!("topic {}", config.topic))),
        })
    }
}
