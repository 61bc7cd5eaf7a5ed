//! The routes of services and actions, as the [manager](crate::manager) has them.

use std::sync::Arc;

use anyhow::anyhow;
use gdp::Node;
use gdp_ros::types::Types;

use crate::call::material::CallMaterial;
use crate::call::{CallStats, Route};
use crate::config::{CallConfig, Side, What};
use crate::graph::Graph;
use crate::manager::{Failure, Manager, Plan, Work};
use crate::ros2::TopicName;

pub type Calls = Manager<Arc<CallPlan>>;

/// A service or an action in one direction, with all that its route needs.
pub struct CallPlan {
    pub config: CallConfig,
    /// What the configuration calls the graph.
    pub label: String,
    pub graph: Arc<Graph>,
    pub material: CallMaterial,
}

/// The route of a plan.
pub struct CallWork {
    route: Route,
    plan: Arc<CallPlan>,
    node: Node,
}

/// Of a node, with these types.
pub fn manager(node: Node, types: Arc<Types>) -> Calls {
    Manager::new(move |plan: &Arc<CallPlan>| {
        let route = Route::new(&plan.config, &plan.label, &plan.material, types.clone());
        CallWork { route, plan: plan.clone(), node: node.clone() }
    })
}

/// What a right is comes from its file, which the route looks at itself: another right is no other route.
impl PartialEq for CallPlan {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.graph, &other.graph)
            && self.config == other.config
            && self.label == other.label
            && self.material.card == other.material.card
            && self.material.kind == other.material.kind
    }
}

impl Plan for Arc<CallPlan> {
    type Place = (String, What, TopicName, Side);
    type Work = CallWork;

    fn place(&self) -> Self::Place {
        (self.label.clone(), self.config.what, self.config.name.clone(), self.config.side)
    }
}

impl Work for CallWork {
    type Stats = CallStats;

    fn stats(&self) -> CallStats {
        self.route.stats()
    }

    fn failed(&self, why: &str) {
        self.route.ended(why);
    }

    async fn run(&self, stop: impl Future<Output = ()>) -> Result<(), Failure> {
        let CallPlan { graph, material, .. } = &*self.plan;
        let ended = self.route.run(graph, &self.node, material.clone(), stop).await;
        ended.map_err(|error| match error.may_pass() {
            true => Failure::Passing(error.to_string()),
            false => Failure::Final(anyhow!(error).context(self.route.title())),
        })
    }
}
