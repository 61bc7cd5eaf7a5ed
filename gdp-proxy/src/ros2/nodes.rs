//! The ROS nodes of a domain. Each participant announces its nodes, with the GUIDs of their readers
//! and writers, on the topic `ros_discovery_info` of rmw_dds_common. So a participant may have many
//! nodes: that of this proxy, and one for each remote node with an endpoint here.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use byteorder::{BigEndian, LittleEndian};
use parking_lot::Mutex;
use ros2_client::NodeName;
use rustdds::GUID;
use serde::{Deserialize, Serialize};
use tokio::sync::{Notify, watch};

/// The DDS topic of the announcements, and its type.
pub(super) const TOPIC: &str = "ros_discovery_info";
pub(super) const TYPE: &str = "rmw_dds_common/msg/ParticipantEntitiesInfo";

/// Bound on the participants whose nodes are known. Beyond it, those that have left are forgotten.
const MAX_PARTICIPANTS: usize = 1024;

/// Bound on the endpoints of one participant whose node is known.
const MAX_ENDPOINTS: usize = 8192;

/// The GUID prefix of all endpoints of a participant.
type Participant = [u8; 12];

/// What the other participants announce: the full name of the node of each endpoint. A participant
/// without an entry has announced nothing that can be read yet.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct NodeNames(HashMap<Participant, Arc<Endpoints>>);

/// The node of each endpoint of a participant.
type Endpoints = HashMap<[u8; 16], Arc<str>>;

impl NodeNames {
    /// Returns the node of an endpoint, or an empty text.
    pub fn node(&self, endpoint: [u8; 16]) -> Arc<str> {
        let names = self.0.get(&prefix(&endpoint));
        names.and_then(|names| names.get(&endpoint)).cloned().unwrap_or_default()
    }

    #[cfg(test)]
    pub fn of<const N: usize>(endpoints: [([u8; 16], &str); N]) -> Self {
        let mut names: HashMap<_, Endpoints> = HashMap::new();
        for (endpoint, node) in endpoints {
            names.entry(prefix(&endpoint)).or_default().insert(endpoint, node.into());
        }
        Self(names.into_iter().map(|(participant, names)| (participant, names.into())).collect())
    }

    /// Whether the participant has announced that it has no nodes, or in a form that is unknown.
    pub fn has_none(&self, participant: &Participant) -> bool {
        self.0.get(participant).is_some_and(|names| names.is_empty())
    }
}

/// The nodes of this participant, and those of the others.
pub(super) struct Nodes {
    participant: GUID,
    own: NodeName,
    entries: Mutex<BTreeMap<u64, NodeOfEndpoint>>,
    next: AtomicU64,
    changed: Notify,
    remote: watch::Sender<Arc<NodeNames>>,
}

struct NodeOfEndpoint {
    /// The node, or `None` for that of the proxy.
    node: Option<NodeName>,
    endpoint: GUID,
}

/// The place of one endpoint among the nodes, until it is dropped.
pub struct NodeEntry {
    nodes: Arc<Nodes>,
    number: u64,
}

/// rmw_dds_common/msg/ParticipantEntitiesInfo, with GIDs of 16 bytes as since Iron.
#[derive(Serialize, Deserialize)]
struct ParticipantEntities {
    gid: [u8; 16],
    nodes: Vec<NodeEntities>,
}

#[derive(Serialize, Deserialize)]
struct NodeEntities {
    namespace: String,
    name: String,
    readers: Vec<[u8; 16]>,
    writers: Vec<[u8; 16]>,
}

impl Nodes {
    pub fn new(participant: GUID, own: NodeName) -> Self {
        let (entries, next, changed) = (Mutex::default(), AtomicU64::new(0), Notify::new());
        changed.notify_one();
        Self { participant, own, entries, next, changed, remote: watch::Sender::default() }
    }

    /// Adds an endpoint of this participant to the proxy's node.
    pub fn add(self: &Arc<Self>, endpoint: GUID) -> NodeEntry {
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        self.entries.lock().insert(number, NodeOfEndpoint { node: None, endpoint });
        self.changed.notify_one();
        NodeEntry { nodes: self.clone(), number }
    }

    /// Returns the nodes of the other participants, with every change.
    pub fn remote(&self) -> watch::Receiver<Arc<NodeNames>> {
        self.remote.subscribe()
    }

    /// Forgets participants that are not present, if there are too many. Otherwise they stay: one
    /// that returns after an outage does not announce its nodes again.
    pub fn retain(&self, present: &HashSet<Participant>) {
        self.remote.send_if_modified(|names| {
            if names.0.len() >= MAX_PARTICIPANTS {
                Arc::make_mut(names).0.retain(|participant, _| present.contains(participant));
            }
            // Graphs without these endpoints are the same.
            false
        });
    }

    /// Waits until the nodes of this participant have changed since the last call.
    pub async fn changed(&self) {
        self.changed.notified().await;
    }

    /// Lets the next call of [`Self::changed`] return at once.
    pub fn announce_again(&self) {
        self.changed.notify_one();
    }

    /// Returns the announcement of this participant: a CDR encapsulation.
    pub fn announcement(&self) -> Vec<u8> {
        let mut nodes: BTreeMap<(&str, &str), NodeEntities> = BTreeMap::new();
        let entries = self.entries.lock();
        let of = |name: &NodeName| NodeEntities {
            namespace: name.namespace().to_owned(),
            name: name.base_name().to_owned(),
            readers: vec![],
            writers: vec![],
        };
        let key = |name| (NodeName::namespace(name), NodeName::base_name(name));
        nodes.insert(key(&self.own), of(&self.own));
        for NodeOfEndpoint { node, endpoint } in entries.values() {
            let name = node.as_ref().unwrap_or(&self.own);
            let node = nodes.entry(key(name)).or_insert_with(|| of(name));
            match endpoint.entity_id.kind().is_writer() {
                true => node.writers.push(endpoint.to_bytes()),
                false => node.readers.push(endpoint.to_bytes()),
            }
        }
        let entities = ParticipantEntities { gid: self.participant.to_bytes(), nodes: nodes.into_values().collect() };
        encode(&entities)
    }

    /// Replaces what is known of the participant `from` by its announcement, a CDR encapsulation.
    /// Another participant cannot announce its endpoints.
    pub fn take(&self, from: Participant, announcement: &[u8]) {
        let entities = decode(announcement).map_or_else(Vec::new, |entities| entities.nodes);
        let mut new = Endpoints::new();
        for NodeEntities { namespace, name, readers, writers } in entities {
            let Ok(name) = NodeName::new(&namespace, &name) else { continue };
            let name: Arc<str> = name.fully_qualified_name().into();
            let endpoints = readers.into_iter().chain(writers).filter(|endpoint| prefix(endpoint) == from);
            new.extend(
                endpoints.take(MAX_ENDPOINTS.saturating_sub(new.len())).map(|endpoint| (endpoint, name.clone())),
            );
        }
        self.remote.send_if_modified(|names| {
            let before = names.0.get(&from);
            let is_news = before.is_none_or(|before| **before != new);
            let has_room = before.is_some() || names.0.len() < MAX_PARTICIPANTS;
            if is_news && has_room {
                Arc::make_mut(names).0.insert(from, new.into());
            }
            is_news && has_room
        });
    }
}

impl NodeEntry {
    /// Moves the endpoint to the node with this full name. A text that is no name of a node stands
    /// for the proxy's node.
    pub fn assign(&self, node: &str) {
        let node = parse(node);
        if let Some(entry) = self.nodes.entries.lock().get_mut(&self.number) {
            entry.node = node;
        }
        self.nodes.changed.notify_one();
    }
}

impl Drop for NodeEntry {
    fn drop(&mut self) {
        self.nodes.entries.lock().remove(&self.number);
        self.nodes.changed.notify_one();
    }
}

fn parse(node: &str) -> Option<NodeName> {
    let (namespace, name) = node.rsplit_once('/')?;
    NodeName::new(if namespace.is_empty() { "/" } else { namespace }, name).ok()
}

fn prefix(endpoint: &[u8; 16]) -> Participant {
    std::array::from_fn(|i| endpoint[i])
}

fn encode(entities: &ParticipantEntities) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    // Writing to memory does not fail, and the types have no value that CDR lacks.
    if let Err(error) = cdr_encoding::to_writer::<_, LittleEndian, _>(&mut bytes, entities) {
        tracing::error!("the nodes of this participant cannot be encoded: {error}");
    }
    bytes
}

fn decode(announcement: &[u8]) -> Option<ParticipantEntities> {
    let decoded = match announcement.split_first_chunk()? {
        ([0, 1, _, _], body) => cdr_encoding::from_bytes::<ParticipantEntities, LittleEndian>(body),
        ([0, 0, _, _], body) => cdr_encoding::from_bytes::<ParticipantEntities, BigEndian>(body),
        _ => return None,
    };
    decoded.ok().map(|(entities, _)| entities)
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/nodes.rs"]
mod tests;
