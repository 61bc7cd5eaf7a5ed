//! Services and actions: clients of local servers, and servers on behalf of remote ones.

use bytes::Bytes;
use gdp_ros::call::{Failure, FailureCode};
use gdp_ros_zenoh::{Inbox, QueryError, RawClient, RawServer, RawSubscriber, Reply, Role, Snapshot, TypeHash};
use tokio::sync::Mutex;
use tokio::time::timeout;

use super::writer::described;
use super::{ZenohGraph, view};
use crate::graph::event::GraphError;
use crate::graph::services::MATCHED;
use crate::ros2::{Qos, RawSample, ServicePeer, TopicName, TypeName};
use gdp_ros::roster::Offer;

/// A client of the local servers of a service.
pub struct ZenohClient(RawClient);

/// A server on behalf of a remote one.
pub struct ZenohServer(RawServer);

/// What a response needs of its request.
pub struct ZenohReply(Reply);

/// A reader of one topic of an action.
pub struct ZenohFeed {
    inbox: Mutex<Inbox>,
    _subscriber: RawSubscriber,
}

impl ZenohGraph {
    /// Creates a client of a service of this server, and waits until it can be called. Returns the
    /// hash of the service's type as well.
    pub async fn client(
        &self,
        name: &TopicName,
        kind: &TypeName,
        peer: &ServicePeer,
    ) -> Result<(ZenohClient, Vec<u8>), GraphError> {
        let hash = self.hash_of(Role::Server, name, kind, peer).await?;
        let service = described(name, kind, &hash.0, &Offer::DEFAULT)?;
        let client = RawClient::new(&self.node, &service)?;
        let unmatched = || GraphError::Zenoh(format!("the server of {name} has no complete queryable"));
        timeout(MATCHED, client.until_matched()).await.map_err(|_| unmatched())?;
        Ok((ZenohClient(client), hash.0.to_vec()))
    }

    /// Reads a topic of the action of this server.
    pub async fn feed(
        &self,
        (name, kind): &(TopicName, TypeName),
        qos: Qos,
        peer: &ServicePeer,
    ) -> Result<ZenohFeed, GraphError> {
        let hash = self.hash_of(Role::Publisher, name, kind, peer).await?;
        let topic = described(name, kind, &hash.0, &qos.into())?;
        let inbox = Inbox::default();
        let subscriber = RawSubscriber::new(&self.node, &topic, &inbox)?;
        Ok(ZenohFeed { inbox: inbox.into(), _subscriber: subscriber })
    }

    /// Creates a server of the proxy's own node. `hash` is that of the service's type.
    pub fn server(&self, name: &TopicName, kind: &TypeName, hash: &[u8]) -> Result<ZenohServer, GraphError> {
        let service = described(name, kind, hash, &Offer::DEFAULT)?;
        Ok(ZenohServer(RawServer::new(&self.node, service)?))
    }

    /// Returns the hash of the type that the session of `peer` announces for an endpoint. The
    /// endpoints of an action appear one after another.
    async fn hash_of(
        &self,
        role: Role,
        name: &TopicName,
        kind: &TypeName,
        peer: &ServicePeer,
    ) -> Result<TypeHash, GraphError> {
        let (mut graph, kind) = (self.node.graph(), kind.to_dds());
        let find = |snapshot: &Snapshot| {
            let of_peer = snapshot.entities.iter().find(|entity| entity.gid == peer.id)?;
            let session = &of_peer.token.session;
            let mut all = view::others(snapshot, role).filter(|(entity, _)| entity.token.session == *session);
            let (_, endpoint) = all.find(|(_, endpoint)| endpoint.name == name.as_str() && endpoint.kind == kind)?;
            Some(endpoint.hash)
        };
        let found = async {
            loop {
                if let Some(hash) = find(&graph.borrow_and_update()) {
                    return hash.ok_or_else(|| GraphError::NoHash(kind.clone()));
                }
                graph.changed().await.map_err(|_| GraphError::Left)?;
            }
        };
        let absent = || GraphError::Zenoh(format!("the server's node does not announce {name} of {kind}"));
        timeout(MATCHED, found).await.map_err(|_| absent())?
    }
}

impl ZenohClient {
    /// Calls the server and waits for the answer without a timeout.
    pub async fn call(&self, request: Bytes) -> Result<Bytes, Failure> {
        let malformed = || Failure::new(FailureCode::Malformed, "not a CDR encapsulation that ROS 2 uses");
        let sample = RawSample::parse(request).ok_or_else(malformed)?;
        self.0.call(sample.bytes).await.map_err(|error| {
            let code = match error {
                QueryError::Busy => FailureCode::Busy,
                QueryError::Message(_) => FailureCode::Malformed,
                QueryError::Left | QueryError::Zenoh(_) => FailureCode::ServerLeft,
            };
            Failure::new(code, error)
        })
    }
}

impl ZenohServer {
    /// Shows the server as one of the node with this full name.
    pub fn assign(&self, node: &str) {
        if let Err(error) = self.0.assign(node) {
            tracing::debug!(node, "the server stays one of the proxy: {error}");
        }
    }

    /// Waits for the next request. Safe to cancel.
    pub async fn next(&self) -> (Bytes, ZenohReply) {
        let (request, reply) = self.0.recv().await.into_parts();
        (request, ZenohReply(reply))
    }
}

impl ZenohReply {
    /// Sends the response to the client.
    pub async fn send(self, response: Bytes) -> Result<(), String> {
        let sample = RawSample::parse(response).ok_or("the response is no CDR that ROS 2 uses")?;
        self.0.send(sample.bytes).await.map_err(|error| error.to_string())
    }
}

impl ZenohFeed {
    /// Waits for the next message. Safe to cancel.
    pub async fn next(&self) -> Result<Bytes, String> {
        let received = self.inbox.lock().await.recv().await;
        received.map(|received| received.bytes).map_err(|refusal| refusal.error.to_string())
    }
}
