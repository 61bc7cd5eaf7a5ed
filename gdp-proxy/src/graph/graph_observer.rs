//! Observes what other nodes publish and serve in a ROS graph. It leaves out the proxies' own
//! endpoints.

use std::collections::BTreeMap;
use std::sync::Arc;

use tokio::sync::watch;

use super::Graph;
use super::ros1::{actions, is_proxy};
use crate::config::{Thing, What};
use crate::ros2::{self, DisplayedQos, ServicePeer, TopicName, TypeName};

/// The topics that have publishers, and the services and actions that have servers.
pub type Found = BTreeMap<(Thing, TopicName), Vec<Offered>>;

/// The type and QoS of a publisher or server. ROS 1 has one entry for all nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Offered {
    /// The type as ROS 2 writes it. A ROS 1 master does not know the types of services.
    pub kind: Option<TypeName>,
    /// The QoS of a ROS 2 publisher.
    pub qos: Option<DisplayedQos>,
}

/// An observer of one graph.
pub enum GraphObserver {
    Ros1(gdp_ros1::Graph),
    Ros2(watch::Receiver<Arc<ros2::Graph>>),
}

impl GraphObserver {
    pub fn of(graph: &Graph) -> Self {
        match graph {
            Graph::Ros1(master) => Self::Ros1(master.graph()),
            Graph::Ros2(domain) => Self::Ros2(domain.graph()),
            Graph::Zenoh(graph) => Self::Ros2(graph.graph()),
        }
    }

    /// Waits until the graph changes, or forever once the graph was left. Safe to cancel.
    pub async fn changed(&mut self) {
        let changed = match self {
            Self::Ros1(graph) => graph.changes().await.is_some(),
            Self::Ros2(graph) => graph.changed().await.is_ok(),
        };
        if !changed {
            std::future::pending().await
        }
    }

    /// Returns the present entities. Names and types that are invalid in ROS are left out.
    pub fn found(&self) -> Found {
        match self {
            Self::Ros1(graph) => of_ros1(graph.snapshot()),
            Self::Ros2(graph) => of_ros2(&graph.borrow()),
        }
    }
}

/// Whether nodes other than proxies use a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TopicUse {
    pub is_published: bool,
    pub is_subscribed: bool,
}

impl TopicUse {
    pub fn of(graph: &Graph, topic: &TopicName) -> Self {
        match GraphObserver::of(graph) {
            GraphObserver::Ros1(graph) => {
                let (latest, is_node) = (graph.latest(), |node: &String| !is_proxy(node));
                let topic = latest.topics.get(topic.as_str());
                Self {
                    is_published: topic.is_some_and(|topic| topic.publishers.iter().any(is_node)),
                    is_subscribed: topic.is_some_and(|topic| topic.subscribers.iter().any(is_node)),
                }
            }
            GraphObserver::Ros2(graph) => {
                let graph = graph.borrow();
                let topic = graph.topics.get(topic);
                Self {
                    is_published: topic.is_some_and(|topic| !topic.publishers.is_empty()),
                    is_subscribed: topic.is_some_and(|topic| !topic.subscribers.is_empty()),
                }
            }
        }
    }
}

/// Returns the names of at most `most` topics that others publish, or of services and actions that
/// they serve, and how many more there are.
pub fn names_in(graph: &Graph, are_calls: bool, most: usize) -> (Vec<String>, usize) {
    let found = match GraphObserver::of(graph) {
        GraphObserver::Ros1(graph) => of_ros1(&graph.latest()),
        GraphObserver::Ros2(graph) => of_ros2(&graph.borrow()),
    };
    let names = found.keys().filter(|(thing, _)| matches!(thing, Thing::Call(_)) == are_calls);
    let mut names: Vec<String> = names.map(|(_, name)| name.to_string()).collect();
    let more = names.len().saturating_sub(most);
    names.truncate(most);
    (names, more)
}

fn of_ros1(there: &gdp_ros1::Snapshot) -> Found {
    let topics = there.topics.iter().filter_map(|(name, topic)| {
        topic.publishers.iter().find(|node| !is_proxy(node))?;
        let kind = TypeName::parse(&topic.kind.as_ref()?.replacen('/', "/msg/", 1)).ok()?;
        Some((Thing::Topic, name, Some(kind)))
    });
    let services = there.services.iter().filter(|(_, nodes)| nodes.iter().any(|node| !is_proxy(node)));
    let actions = actions::all(there).map(|(name, kind)| (Thing::Call(What::Action), name, Some(kind)));
    let topics = topics.map(|(thing, name, kind)| (thing, name.as_str(), kind));
    let services = services.map(|(name, _)| (Thing::Call(What::Service), name.as_str(), None));
    let all = topics.chain(services).chain(actions).filter_map(|(thing, name, kind)| {
        Some(((thing, TopicName::parse(name).ok()?), vec![Offered { kind, qos: None }]))
    });
    all.collect()
}

fn of_ros2(graph: &ros2::Graph) -> Found {
    let published = |topic: &ros2::TopicInfo| {
        let publishers = topic.publishers.iter();
        publishers.map(|it| Offered { kind: Some(it.kind.clone()), qos: Some(it.qos) }).collect()
    };
    let served = |servers: &[ServicePeer]| -> Vec<Offered> {
        servers.iter().map(|it| Offered { kind: Some(it.kind.clone()), qos: None }).collect()
    };
    let topics = graph.topics.iter().map(|(name, it)| (Thing::Topic, name, published(it)));
    let services = graph.services.iter().map(|(name, it)| (Thing::Call(What::Service), name, served(&it.servers)));
    let actions = graph.actions.iter().map(|(name, it)| (Thing::Call(What::Action), name, served(&it.servers)));
    let all = topics.chain(services).chain(actions).filter(|(.., offered)| !offered.is_empty());
    all.map(|(thing, name, offered)| ((thing, name.clone()), offered)).collect()
}
