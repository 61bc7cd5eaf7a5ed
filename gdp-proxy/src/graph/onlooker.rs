//! What others publish in a ROS graph, for whoever chooses among it. What proxies publish is not in it.

use std::collections::BTreeMap;
use std::sync::Arc;

use tokio::sync::watch;

use super::Graph;
use super::ros1::is_proxy;
use crate::ros2::{self, ShownQos, TopicName, TypeName};

/// The topics that have publishers.
pub type Topics = BTreeMap<TopicName, Vec<Published>>;

/// What a topic is published as; of ROS 1, one for all publishers.
#[derive(Clone, Debug, PartialEq)]
pub struct Published {
    /// As ROS 2 writes it.
    pub kind: TypeName,
    /// Of ROS 2.
    pub qos: Option<ShownQos>,
}

/// Watches one graph.
pub enum Onlooker {
    Ros1(gdp_ros1::Graph),
    Ros2(watch::Receiver<Arc<ros2::Graph>>),
}

impl Onlooker {
    pub fn of(graph: &Graph) -> Self {
        match graph {
            Graph::Ros1(master) => Self::Ros1(master.graph()),
            Graph::Ros2(domain) => Self::Ros2(domain.graph()),
        }
    }

    /// Waits until something about it changes; for ever once the graph was left. Safe to cancel.
    pub async fn changed(&mut self) {
        let changed = match self {
            Self::Ros1(graph) => graph.changes().await.is_some(),
            Self::Ros2(graph) => graph.changed().await.is_ok(),
        };
        if !changed {
            std::future::pending().await
        }
    }

    /// What is published now. Names and types that are none of ROS's are left out.
    pub fn topics(&self) -> Topics {
        match self {
            Self::Ros1(graph) => {
                graph.snapshot().topics.iter().filter_map(|(name, topic)| of_ros1(name, topic)).collect()
            }
            Self::Ros2(graph) => of_ros2(&graph.borrow()),
        }
    }
}

fn of_ros1(name: &str, topic: &gdp_ros1::Topic) -> Option<(TopicName, Vec<Published>)> {
    topic.publishers.iter().find(|node| !is_proxy(node))?;
    let kind = TypeName::parse(&topic.kind.as_ref()?.replacen('/', "/msg/", 1)).ok()?;
    Some((TopicName::parse(name).ok()?, vec![Published { kind, qos: None }]))
}

fn of_ros2(graph: &ros2::Graph) -> Topics {
    let published = graph.topics.iter().filter(|(_, topic)| !topic.publishers.is_empty());
    let of = |topic: &ros2::TopicInfo| {
        let publishers = topic.publishers.iter();
        publishers.map(|endpoint| Published { kind: endpoint.kind.clone(), qos: Some(endpoint.qos) }).collect()
    };
    published.map(|(name, topic)| (name.clone(), of(topic))).collect()
}
