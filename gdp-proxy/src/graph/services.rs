//! Services of a ROS graph, of either ROS version: local servers, calls to them, and servers on
//! behalf of remote ones. Requests and responses are in the graph's own encoding.

use std::time::Duration;

use bytes::Bytes;
use futures::future::{join, join_all};
use gdp_ros1::{CallError, ServiceServer, ServiceType};
use tokio::sync::{Mutex, mpsc, oneshot, watch};
use tokio::time::timeout;

use super::{Graph, ros1, zenoh};
use crate::config::What;
use crate::graph::event::GraphError;
use crate::ros2::{self, ClientLife, RawReader, RawSample, RequestId, ServicePeer, TopicName, TypeName};
use gdp_ros::action::GoalId;
use gdp_ros::call::{Description, Failure, FailureCode};
use gdp_ros::roster::{Dialect, Kind};
use gdp_ros::types::TypeError;

/// Timeout for a ROS 1 server to announce its type.
const PROBE: Duration = Duration::from_secs(5);

/// Timeout for the endpoints of a ROS 2 server, or an action server of ROS 1, to match the proxy's
/// client.
pub(super) const MATCHED: Duration = Duration::from_secs(5);

/// Time to wait until a participant that announces its nodes has announced that of a server.
const NODE_KNOWN: Duration = Duration::from_secs(3);

/// Bound on concurrent requests of a ROS 1 service. Further ones wait at their connections.
const CONCURRENT: usize = 256;

/// An observer of the local servers of one service or action. It ignores those of proxies, because
/// they stand for remote servers.
pub enum Servers {
    Ros1 { graph: gdp_ros1::Graph, name: String, what: What },
    Ros2 { graph: watch::Receiver<std::sync::Arc<ros2::Graph>>, name: TopicName, what: What },
}

/// A local server.
#[derive(Clone, Debug, PartialEq)]
pub enum Peer {
    /// The node's name.
    Ros1(String),
    Ros2(ServicePeer),
}

impl Peer {
    /// Returns the full name of the server's node, or an empty text if the graph does not tell it.
    pub fn node(&self) -> &str {
        match self {
            Self::Ros1(node) => node,
            Self::Ros2(peer) => &peer.node,
        }
    }

    fn awaits_node(&self) -> bool {
        matches!(self, Self::Ros2(peer) if peer.awaits_node)
    }

    /// Whether it is the same server. Its node may be known later than the server.
    fn is(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Ros2(one), Self::Ros2(other)) => {
                (one.id, &one.kind, one.mapping) == (other.id, &other.kind, other.mapping)
            }
            (one, other) => one == other,
        }
    }
}

impl Servers {
    pub fn new(graph: &Graph, name: &TopicName, what: What) -> Self {
        match graph {
            Graph::Ros1(master) => Self::Ros1 { graph: master.node().graph(), name: name.as_str().into(), what },
            Graph::Ros2(domain) => Self::Ros2 { graph: domain.graph(), name: name.clone(), what },
            Graph::Zenoh(zenoh) => Self::Ros2 { graph: zenoh.graph(), name: name.clone(), what },
        }
    }

    /// Waits until there is a server, and shortly for its node. Safe to cancel, as
    /// [`Self::until_left`].
    pub async fn until_there(&mut self) -> Result<Peer, GraphError> {
        let found = self.until(|peers| peers.first().cloned()).await?;
        if !found.awaits_node() {
            return Ok(found);
        }
        let with_node = self.until(|peers| peers.into_iter().find(|peer| peer.is(&found) && !peer.awaits_node()));
        timeout(NODE_KNOWN, with_node).await.unwrap_or(Ok(found))
    }

    /// Waits until this server has left.
    pub async fn until_left(&mut self, peer: &Peer) -> Result<(), GraphError> {
        self.until(|peers| (!peers.iter().any(|there| there.is(peer))).then_some(())).await
    }

    async fn until<T>(&mut self, mut is_so: impl FnMut(Vec<Peer>) -> Option<T>) -> Result<T, GraphError> {
        match self {
            Self::Ros1 { graph, name, what } => loop {
                let there = graph.snapshot();
                let nodes: Vec<&String> = match what {
                    What::Service => there.services.get(name).into_iter().flatten().collect(),
                    What::Action => ros1::actions::servers(there, name).collect(),
                };
                let peers = nodes.into_iter().filter(|node| !ros1::is_proxy(node)).cloned().map(Peer::Ros1);
                if let Some(found) = is_so(peers.collect()) {
                    return Ok(found);
                }
                graph.changes().await.ok_or(GraphError::Left)?;
            },
            Self::Ros2 { graph, name, what } => loop {
                let peers: Vec<Peer> = {
                    let now = graph.borrow_and_update();
                    let servers = match what {
                        What::Service => now.services.get(name).map(|service| &service.servers),
                        What::Action => now.actions.get(name).map(|action| &action.servers),
                    };
                    servers.into_iter().flatten().cloned().map(Peer::Ros2).collect()
                };
                if let Some(found) = is_so(peers) {
                    return Ok(found);
                }
                graph.changed().await.map_err(|_| GraphError::Left)?;
            },
        }
    }
}

/// A client of the local servers of a service.
pub enum Caller {
    Ros1 { client: gdp_ros1::ServiceClient, md5sum: String },
    Ros2(Box<ros2::DdsClient>),
    Zenoh(Box<zenoh::ZenohClient>),
}

impl Caller {
    /// Creates a client of a server, and returns it with the graph's type of the service. Waits
    /// until the server can be called.
    pub async fn new(graph: &Graph, name: &TopicName, peer: &Peer) -> Result<(Self, Kind), CallerError> {
        match (graph, peer) {
            (Graph::Ros1(master), Peer::Ros1(_)) => {
                let client = master.node().client(name.as_str()).map_err(GraphError::from)?;
                let gdp_ros1::ServiceInfo { kind: name, md5sum, .. } = client.probe(PROBE).await?;
                let hash = hex::decode(&md5sum).unwrap_or_default();
                Ok((Self::Ros1 { client, md5sum }, Kind { dialect: Dialect::Ros1, name, hash }))
            }
            (Graph::Ros2(domain), Peer::Ros2(peer)) => {
                let kind = Kind { dialect: Dialect::Ros2, name: peer.kind.to_string(), hash: vec![] };
                let [caller] = Self::several(domain, [(name, &peer.kind)], [], peer).await?;
                Ok((caller, kind))
            }
            (Graph::Zenoh(graph), Peer::Ros2(peer)) => {
                let (client, hash) = graph.client(name, &peer.kind, peer).await?;
                let kind = Kind { dialect: Dialect::Ros2, name: peer.kind.to_string(), hash };
                Ok((Self::Zenoh(client.into()), kind))
            }
            _ => Err(GraphError::Left.into()),
        }
    }

    /// Creates clients of several services of one ROS 2 server. It waits until they and these
    /// readers of the server's topics are matched.
    pub async fn several<const N: usize, const M: usize>(
        domain: &ros2::Domain,
        services: [(&TopicName, &TypeName); N],
        topics: [&RawReader; M],
        peer: &ServicePeer,
    ) -> Result<[Self; N], CallerError> {
        let clients = services.map(|(name, kind)| domain.client(name, kind, peer.mapping));
        let clients = clients.into_iter().collect::<Result<Vec<_>, _>>().map_err(GraphError::from)?;
        let matched = join_all(clients.iter().map(|client| client.until_matched(peer.id)));
        let topics = join_all(topics.map(|reader| reader.until_matched(peer.id)));
        timeout(MATCHED, join(matched, topics)).await.map_err(|_| CallerError::Unmatched)?;
        let callers: Vec<_> = clients.into_iter().map(|client| Self::Ros2(client.into())).collect();
        callers.try_into().map_err(|_| GraphError::Left.into())
    }

    /// Whether no server exists any longer, after a call without an answer. A ROS 1 master does not
    /// notice that a server dies. In ROS 2 the graph reports it, so this returns false.
    pub async fn has_lost_server(&self) -> bool {
        match self {
            Self::Ros1 { client, .. } => match client.probe(PROBE).await {
                // A master that does not answer or a busy server proves nothing.
                Ok(_) | Err(CallError::Master(_) | CallError::Timeout { .. }) => false,
                Err(_) => true,
            },
            Self::Ros2(_) | Self::Zenoh(_) => false,
        }
    }

    /// Calls the server and waits for the answer without a timeout.
    pub async fn call(&self, request: Bytes) -> Result<Bytes, Failure> {
        match self {
            Self::Ros1 { client, md5sum } => {
                client.call(md5sum, request, Duration::MAX).await.map_err(|error| match error {
                    CallError::Failed { text, .. } => Failure::new(FailureCode::Refused, text),
                    error => Failure::new(FailureCode::ServerLeft, error),
                })
            }
            Self::Ros2(client) => {
                let malformed = || Failure::new(FailureCode::Malformed, "not a CDR encapsulation that ROS 2 uses");
                let sample = RawSample::parse(request).ok_or_else(malformed)?;
                let answer = client.call(sample).await.map_err(|error| match error {
                    ros2::CallError::Busy => Failure::new(FailureCode::Busy, error),
                    ros2::CallError::BigEndian => Failure::new(FailureCode::Malformed, error),
                    ros2::CallError::Write(_) | ros2::CallError::Closed => Failure::new(FailureCode::ServerLeft, error),
                })?;
                Ok(answer.bytes)
            }
            Self::Zenoh(client) => client.call(request).await,
        }
    }
}

/// Reasons for which a local server cannot be called.
#[derive(Debug, thiserror::Error)]
pub enum CallerError {
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// The error may pass, and another server may come.
    #[error(transparent)]
    Call(#[from] CallError),
    #[error(
        "the local server does not match the proxy's client in {MATCHED:?}: are its types and its QoS those of ROS?"
    )]
    Unmatched,
    /// Another route of the proxy may use a topic of the action.
    #[error(transparent)]
    Node(#[from] gdp_ros1::NodeError),
    #[error("the type of the action's goals is no type of an action")]
    NoActionType,
    #[error("the action cannot be converted: {0}")]
    ActionType(#[from] TypeError),
    #[error(
        "{name} has the MD5 sum {theirs} at the server, and {ours} here: bring the definitions to the same version"
    )]
    OtherAction { name: String, theirs: String, ours: String },
}

impl CallerError {
    /// Whether the reason is the server's type, which seldom changes.
    pub fn is_of_type(&self) -> bool {
        matches!(self, Self::NoActionType | Self::ActionType(_) | Self::OtherAction { .. })
    }
}

/// A server in the local graph, which exists until it is dropped.
pub enum Stand {
    Ros1 { requests: Mutex<mpsc::Receiver<Asked>>, _server: ServiceServer },
    Ros2(Box<ros2::Server>),
    Zenoh(Box<zenoh::ZenohServer>),
}

/// A request of a local client.
pub struct Asked {
    pub request: Bytes,
    pub asker: Asker,
}

/// The client that waits for the response.
pub enum Asker {
    Ros1(oneshot::Sender<Result<Bytes, String>>),
    Ros2(RequestId, ClientLife),
    Zenoh(Box<zenoh::ZenohReply>),
    /// The client of a goal of ROS 1. It learns the outcome from the action's topics.
    Goal(GoalId),
}

impl Stand {
    /// Creates a server of a service with the graph's type.
    pub fn new(graph: &Graph, name: &TopicName, here: &Description) -> Result<Self, GraphError> {
        match graph {
            Graph::Ros1(master) => {
                let kind = ServiceType { name: here.kind.name.clone(), md5sum: hex::encode(&here.kind.hash) };
                let (sender, requests) = mpsc::channel(CONCURRENT);
                let server = master.node().serve(name.as_str(), kind, CONCURRENT, move |request| {
                    let sender = sender.clone();
                    async move {
                        let (asker, answer) = oneshot::channel();
                        let gone = || "the service is not reached any more".to_owned();
                        let asked = Asked { request: request.data, asker: Asker::Ros1(asker) };
                        sender.send(asked).await.map_err(|_| gone())?;
                        answer.await.unwrap_or_else(|_| Err(gone()))
                    }
                })?;
                Ok(Self::Ros1 { requests: Mutex::new(requests), _server: server })
            }
            Graph::Ros2(domain) => {
                let kind = TypeName::parse(&here.kind.name).map_err(ros2::RosError::from)?;
                Ok(Self::Ros2(domain.server(name, &kind, None)?.into()))
            }
            Graph::Zenoh(graph) => {
                let kind = TypeName::parse(&here.kind.name).map_err(ros2::RosError::from)?;
                Ok(Self::Zenoh(graph.server(name, &kind, &here.kind.hash)?.into()))
            }
        }
    }

    /// Shows the server as one of the node with this full name, where the graph can.
    pub fn assign(&self, node: &str) {
        match self {
            Self::Ros1 { .. } => {}
            Self::Ros2(server) => server.assign(node),
            Self::Zenoh(server) => server.assign(node),
        }
    }

    /// Waits for the next request. An `Err` explains why a request is invalid. Safe to cancel.
    pub async fn next(&self) -> Result<Asked, String> {
        match self {
            Self::Ros1 { requests, .. } => match requests.lock().await.recv().await {
                Some(asked) => Ok(asked),
                // The node has left.
                None => std::future::pending().await,
            },
            Self::Ros2(server) => {
                let request = server.recv().await.map_err(|error| error.to_string())?;
                Ok(Asked { request: request.sample.bytes, asker: Asker::Ros2(request.id, request.client) })
            }
            Self::Zenoh(server) => {
                let (request, reply) = server.next().await;
                Ok(Asked { request, asker: Asker::Zenoh(reply.into()) })
            }
        }
    }

    /// Sends the response to the client.
    pub async fn answer(&self, asker: Asker, response: Bytes) -> Result<(), String> {
        match (self, asker) {
            (Self::Ros2(server), Asker::Ros2(id, client)) => {
                let sample = RawSample::parse(response).ok_or("the response is no CDR that ROS 2 uses")?;
                server.respond(&id, &client, sample).await.map_err(|error| error.to_string())
            }
            (Self::Zenoh(_), Asker::Zenoh(reply)) => reply.send(response).await,
            (_, Asker::Ros1(asker)) => {
                // A client that hung up meanwhile needs no response.
                _ = asker.send(Ok(response));
                Ok(())
            }
            (_, Asker::Ros2(..) | Asker::Zenoh(_) | Asker::Goal(_)) => Err("a request of another server".into()),
        }
    }

    /// Waits without a timeout until clients have their answers. ROS 1 connections stay open until
    /// then anyway.
    pub async fn settle(&self) {
        if let Self::Ros2(server) = self {
            server.settle().await;
        }
    }
}

impl Asker {
    /// Refuses the request. Only ROS 1 can inform the client.
    pub fn refuse(self, why: String) {
        if let Self::Ros1(asker) = self {
            _ = asker.send(Err(why));
        }
    }

    /// Waits until the client has gone, as far as the graph reports it.
    pub async fn hangs_up(&mut self) {
        match self {
            Self::Ros1(asker) => asker.closed().await,
            Self::Ros2(_, client) => client.ends().await,
            // Zenoh does not tell.
            Self::Zenoh(_) | Self::Goal(_) => std::future::pending().await,
        }
    }
}
