//! The ROS graph of a DDS domain, built from discovery: publishers, subscribers, servers and
//! clients.
//!
//! A [`Graph`] is built anew from the participant's tables whenever something changes, so it is
//! never incomplete or stale. It does not contain the proxy's own endpoints.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use rustdds::{GUID, QosPolicies, policy};

use super::names::Part;
use super::nodes::{self, NodeNames};
use super::{Action, Durability, Mapping, Reliability, TopicName, TypeName};

/// The DDS topic on which proxies announce themselves. Their endpoints are in no graph, because
/// what they publish comes from the fabric, where others can read it.
pub(super) const PROXY_TOPIC: &str = "gdp_proxy";

/// All announced topics, services and actions, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Graph {
    /// Topics, without those of actions.
    pub topics: BTreeMap<TopicName, TopicInfo>,
    /// Services, without those of actions.
    pub services: BTreeMap<TopicName, ServiceInfo>,
    pub actions: BTreeMap<TopicName, ActionInfo>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct TopicInfo {
    pub publishers: Vec<Endpoint>,
    pub subscribers: Vec<Endpoint>,
}

/// A publisher or a subscriber.
#[derive(Clone, Debug, PartialEq)]
pub struct Endpoint {
    /// The RTPS GUID: 12 bytes of the participant, 4 bytes of the endpoint.
    pub id: [u8; 16],
    pub kind: TypeName,
    /// The hash of the type, if the middleware announces it (Iron and later).
    pub hash: Option<TypeHash>,
    /// The full name of its node, such as `/robot/driver`. It is empty if no node claims it.
    pub node: Arc<str>,
    pub qos: DisplayedQos,
}

/// The QoS of an endpoint as discovery announces it, without history and depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisplayedQos {
    pub reliability: Reliability,
    pub durability: Durability,
    /// `None` means infinite, also for the two below.
    pub deadline: Option<Duration>,
    pub lifespan: Option<Duration>,
    pub liveliness_lease: Option<Duration>,
    /// True if the endpoint itself asserts its liveliness, by topic.
    pub manual_liveliness: bool,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ServiceInfo {
    pub servers: Vec<ServicePeer>,
    pub clients: Vec<ServicePeer>,
}

/// A participant that serves or calls a service: it has an endpoint on both DDS topics of the
/// service.
#[derive(Clone, Debug, PartialEq)]
pub struct ServicePeer {
    /// GUID of the endpoint of the requests.
    pub id: [u8; 16],
    /// The type, such as `example_interfaces/srv/AddTwoInts`.
    pub kind: TypeName,
    pub mapping: Mapping,
    /// The full name of its node, as of an [`Endpoint`].
    pub node: Arc<str>,
    /// Whether its participant announces nodes, and has not announced this one yet.
    pub awaits_node: bool,
}

/// The servers and clients of an action, which are those of its service `send_goal`.
#[derive(Clone, Debug, PartialEq)]
pub struct ActionInfo {
    /// The type, such as `example_interfaces/action/Fibonacci`.
    pub kind: TypeName,
    /// The servers, with the action's type as their `kind`.
    pub servers: Vec<ServicePeer>,
    pub clients: Vec<ServicePeer>,
}

/// The hash of a type's definition (REP 2016): `RIHS01_` and 64 hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeHash(String);

impl TypeHash {
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Reads the hash from an endpoint's user data, a sequence of `key=value;`. RustDDS leaves the
    /// length of four bytes in front of it.
    fn from_user_data(user_data: &[u8]) -> Option<Self> {
        let text = String::from_utf8_lossy(user_data.get(4..)?);
        Self::parse(text.split(';').find_map(|entry| entry.strip_prefix("typehash="))?)
    }

    /// Reads a hash, or returns `None` if it is of another form.
    pub fn parse(hash: &str) -> Option<Self> {
        let digits = hash.strip_prefix("RIHS01_")?;
        let good = digits.len() == 64 && digits.bytes().all(|c| matches!(c, b'0'..=b'9' | b'a'..=b'f'));
        good.then(|| Self(hash.to_owned()))
    }
}

/// An endpoint as discovery announces it.
pub(super) struct Seen {
    pub guid: GUID,
    pub writes: bool,
    pub topic: String,
    pub kind: String,
    pub qos: QosPolicies,
    pub user_data: Vec<u8>,
}

/// The endpoints of a service at one participant.
#[derive(Default)]
struct Pair {
    requests: Option<(GUID, TypeName)>,
    has_replies: bool,
}

impl Graph {
    pub(super) fn new(seen: impl Iterator<Item = Seen>, names: &NodeNames) -> Self {
        let mut graph = Self::default();
        // The key is the service, the participant, and whether it serves.
        let mut pairs: BTreeMap<(TopicName, [u8; 12], bool), Pair> = BTreeMap::new();
        let seen: Vec<Seen> = seen.collect();
        let is_proxy = |seen: &&Seen| seen.writes && seen.topic == PROXY_TOPIC;
        let proxies: HashSet<[u8; 12]> = seen.iter().filter(is_proxy).map(|seen| participant(seen.guid)).collect();
        let announces_nodes = |seen: &&Seen| seen.writes && seen.topic == nodes::TOPIC;
        let with_nodes: HashSet<[u8; 12]> =
            seen.iter().filter(announces_nodes).map(|seen| participant(seen.guid)).collect();
        for seen in seen.into_iter().filter(|seen| !proxies.contains(&participant(seen.guid))) {
            // Topics and types that are not of ROS are ignored.
            let Some((part, name)) = TopicName::from_dds(&seen.topic) else { continue };
            let Ok(kind) = TypeName::from_dds(&seen.kind) else { continue };
            let key = |serves| (name.clone(), participant(seen.guid), serves);
            match part {
                Part::Topic => graph.add_to_topic(name, kind, node(names, seen.guid), &seen),
                Part::Requests => {
                    if let Some(kind) = kind.without("_Request") {
                        pairs.entry(key(!seen.writes)).or_default().requests = Some((seen.guid, kind));
                    }
                }
                Part::Replies => pairs.entry(key(seen.writes)).or_default().has_replies = true,
            }
        }
        for ((name, _, serves), pair) in pairs {
            let Pair { requests: Some((guid, kind)), has_replies: true } = pair else { continue };
            let id = guid.to_bytes();
            let node = node(names, guid);
            let owner = participant(guid);
            let awaits_node = node.is_empty() && with_nodes.contains(&owner) && !names.has_none(&owner);
            graph.add_peer(&name, serves, ServicePeer { id, kind, mapping: Mapping::of(id), node, awaits_node });
        }
        for topic in graph.topics.values_mut() {
            topic.publishers.sort_by_key(|endpoint| endpoint.id);
            topic.subscribers.sort_by_key(|endpoint| endpoint.id);
        }
        graph
    }

    fn add_to_topic(&mut self, name: TopicName, kind: TypeName, node: Arc<str>, seen: &Seen) {
        let (id, hash) = (seen.guid.to_bytes(), TypeHash::from_user_data(&seen.user_data));
        let endpoint = Endpoint { id, kind, hash, node, qos: DisplayedQos::new(&seen.qos, seen.writes) };
        self.add_endpoint(name, endpoint, seen.writes);
    }

    /// Adds a publisher or subscriber. Those of actions are left out.
    pub(crate) fn add_endpoint(&mut self, name: TopicName, endpoint: Endpoint, writes: bool) {
        if Action::part_of(&name).is_none() {
            let topic = self.topics.entry(name).or_default();
            if writes { &mut topic.publishers } else { &mut topic.subscribers }.push(endpoint);
        }
    }

    /// Adds a server or client of a service. That of `send_goal` stands for its action.
    pub(crate) fn add_peer(&mut self, name: &TopicName, serves: bool, mut peer: ServicePeer) {
        let (servers, clients) = match Action::part_of(name) {
            Some((action, "send_goal")) => {
                let Some(kind) = Action::kind_of(&peer.kind) else { return };
                peer.kind = kind.clone();
                let action = self.actions.entry(action);
                let action = action.or_insert(ActionInfo { kind, servers: Vec::new(), clients: Vec::new() });
                (&mut action.servers, &mut action.clients)
            }
            Some(_) => return,
            None => {
                let service = self.services.entry(name.clone()).or_default();
                (&mut service.servers, &mut service.clients)
            }
        };
        if serves { servers } else { clients }.push(peer);
    }
}

impl DisplayedQos {
    /// Reads the announced QoS. Absent policies have DDS's default, which differs between writers
    /// and readers.
    fn new(qos: &QosPolicies, of_writer: bool) -> Self {
        let reliability = match qos.reliability() {
            Some(policy::Reliability::Reliable { .. }) => Reliability::Reliable,
            Some(policy::Reliability::BestEffort) => Reliability::BestEffort,
            None if of_writer => Reliability::Reliable,
            None => Reliability::BestEffort,
        };
        let durability = match qos.durability() {
            Some(policy::Durability::Volatile) | None => Durability::Volatile,
            Some(_) => Durability::TransientLocal,
        };
        let (manual_liveliness, lease) = match qos.liveliness() {
            Some(policy::Liveliness::ManualByTopic { lease_duration }) => (true, Some(lease_duration)),
            Some(
                policy::Liveliness::Automatic { lease_duration }
                | policy::Liveliness::ManualByParticipant { lease_duration },
            ) => (false, Some(lease_duration)),
            None => (false, None),
        };
        Self {
            reliability,
            durability,
            deadline: qos.deadline().and_then(|deadline| finite(deadline.0)),
            lifespan: qos.lifespan().and_then(|lifespan| finite(lifespan.duration)),
            liveliness_lease: lease.and_then(finite),
            manual_liveliness,
        }
    }
}

/// Returns the user data by which an endpoint announces the hash of its type, or nothing without a
/// hash.
pub(super) fn user_data(hash: &[u8]) -> Vec<u8> {
    match hash {
        [] => Vec::new(),
        hash => format!("typehash=RIHS01_{};", hex::encode(hash)).into_bytes(),
    }
}

fn node(names: &NodeNames, endpoint: GUID) -> Arc<str> {
    names.node(endpoint.to_bytes())
}

/// Converts a duration, which is untrusted and may be negative.
fn finite(duration: rustdds::Duration) -> Option<Duration> {
    let ns = duration.to_nanoseconds();
    // Vendors' values of infinite differ by a fraction of a second. 68 years is the largest
    // representable second.
    let infinite = duration >= rustdds::Duration::from_secs(i32::MAX);
    u64::try_from(ns).ok().filter(|_| !infinite).map(Duration::from_nanos)
}

fn participant(guid: GUID) -> [u8; 12] {
    let bytes = guid.to_bytes();
    std::array::from_fn(|i| bytes[i])
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/graph.rs"]
mod tests;
