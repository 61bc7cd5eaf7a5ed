//! The graph of liveliness tokens in the terms of ROS, without what proxies have in it.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use gdp_ros::roster::{Dialect, Kind, Offer};
use gdp_ros_zenoh::{Endpoint, Entity, Gid, Qos, Role, Snapshot, Token};

use crate::graph::event::{Key, NODE};
use crate::ros2::{self, DisplayedQos, Durability, Graph, Mapping, Reliability, ServicePeer, TopicName, TypeName};

/// Returns the sessions of proxies, whose messages come from the fabric.
pub fn proxies(snapshot: &Snapshot) -> HashSet<&str> {
    let nodes = snapshot.entities.iter().map(|entity| &entity.token);
    let is_proxy = |token: &&Token| token.role == Role::Node && token.namespace == "/" && token.node.starts_with(NODE);
    nodes.filter(is_proxy).map(|token| token.session.as_str()).collect()
}

/// Returns the entities of other nodes than proxies that have this role.
pub fn others(snapshot: &Snapshot, role: Role) -> impl Iterator<Item = (&Entity, &Endpoint)> {
    let proxies = proxies(snapshot);
    let all = snapshot.entities.iter().filter(move |entity| entity.token.role == role);
    let all = all.filter(move |entity| !proxies.contains(entity.token.session.as_str()));
    all.filter_map(|entity| Some((&**entity, entity.token.endpoint.as_ref()?)))
}

/// Builds the graph. Names and types that are not of ROS are left out.
pub fn graph(snapshot: &Snapshot) -> Graph {
    let mut graph = Graph::default();
    for role in [Role::Publisher, Role::Subscriber, Role::Server, Role::Client] {
        for (entity, endpoint) in others(snapshot, role) {
            let Ok(name) = TopicName::parse(&endpoint.name) else { continue };
            let Ok(kind) = TypeName::from_dds(&endpoint.kind) else { continue };
            let (id, node) = (entity.gid, entity.token.full_node().into());
            if let Role::Publisher | Role::Subscriber = role {
                let hash = endpoint.hash.and_then(|hash| ros2::TypeHash::parse(&hash.to_string()));
                let endpoint = ros2::Endpoint { id, kind, hash, node, qos: displayed(&endpoint.qos) };
                graph.add_endpoint(name, endpoint, role == Role::Publisher);
            } else {
                // Zenoh has one form of services.
                let peer = ServicePeer { id, kind, mapping: Mapping::Enhanced, node, awaits_node: false };
                graph.add_peer(&name, role == Role::Server, peer);
            }
        }
    }
    graph
}

/// A publisher in the terms of routes.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    pub kind: Kind,
    pub endpoint: Endpoint,
    pub node: Arc<str>,
    pub session: String,
    pub offers: Offer,
}

/// Returns the publishers of a topic with their keys.
pub fn publishers(snapshot: &Snapshot, topic: &TopicName) -> Vec<(Key, Seen)> {
    let all = others(snapshot, Role::Publisher).filter(|(_, endpoint)| endpoint.name == topic.as_str());
    let all = all.filter_map(|(entity, endpoint)| {
        let name = TypeName::from_dds(&endpoint.kind).ok()?.to_string();
        let hash = endpoint.hash.map_or_else(Vec::new, |hash| hash.0.to_vec());
        let seen = Seen {
            kind: Kind { dialect: Dialect::Ros2, name, hash },
            endpoint: endpoint.clone(),
            node: entity.token.full_node().into(),
            session: entity.token.session.clone(),
            offers: offer(&endpoint.qos),
        };
        Some((key(entity.gid), seen))
    });
    all.collect()
}

pub fn key(gid: Gid) -> Key {
    Key::from_be_bytes(gid)
}

fn displayed(qos: &Qos) -> DisplayedQos {
    let time = |ns: u64| (ns > 0).then(|| Duration::from_nanos(ns));
    DisplayedQos {
        reliability: if qos.reliable { Reliability::Reliable } else { Reliability::BestEffort },
        durability: if qos.transient_local { Durability::TransientLocal } else { Durability::Volatile },
        deadline: time(qos.deadline_ns),
        lifespan: time(qos.lifespan_ns),
        liveliness_lease: time(qos.liveliness_ns),
        manual_liveliness: qos.manual_liveliness,
    }
}

fn offer(qos: &Qos) -> Offer {
    let Qos { reliable, transient_local, depth, deadline_ns, lifespan_ns, liveliness_ns, manual_liveliness } = *qos;
    let depth = depth.map_or(0, |depth| depth.clamp(1, ros2::Depth::MAX.into()));
    Offer { reliable, transient_local, depth, deadline_ns, lifespan_ns, liveliness_ns, manual_liveliness }
}

/// Returns an offer as a token writes it.
pub fn qos(offer: &Offer) -> Qos {
    let Offer { reliable, transient_local, depth, deadline_ns, lifespan_ns, liveliness_ns, manual_liveliness } = *offer;
    let depth = (depth > 0).then(|| depth.min(ros2::Depth::MAX.into()));
    Qos { reliable, transient_local, depth, deadline_ns, lifespan_ns, liveliness_ns, manual_liveliness }
}

#[cfg(test)]
#[path = "../../../tests/unit/graph/zenoh/view.rs"]
mod tests;
