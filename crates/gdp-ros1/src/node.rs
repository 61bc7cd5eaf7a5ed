//! A node at one master, and the handles of its publications, subscriptions and services.

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use parking_lot::Mutex;
use tokio::net::TcpListener;
use tokio::sync::{Notify, watch};
use tokio::task::{JoinHandle, JoinSet};

use crate::api::master::Master;
use crate::api::server;
use crate::config::NodeConfig;
use crate::graph::Graph;
use crate::names::{NameError, resolve, validate_node};
use crate::queue::Queue;
use crate::registrar::Registrar;
use crate::registration::{Key, RegistrationKind, Registrations};
use crate::service::client::ServiceClient;
use crate::service::server::{Service, ServiceRequest, ServiceType};
use crate::shared::{Shared, Status, Subscribed};
use crate::tcpros::listener::listen;
use crate::topic::link::Common;
use crate::topic::publication::{MessageType, Publication, PublishOptions, Subscriber};
use crate::topic::sources::Sources;
use crate::topic::subscription::{ConnectionSupervisor, Listed, Message, SourceStates, SubscribeOptions};

/// Shortest and longest interval between two polls of the master.
const POLL: (Duration, Duration) = (Duration::from_millis(50), Duration::from_secs(60));

/// Timeout for the responses to service calls in progress when the node leaves.
const LAST_ANSWERS: Duration = Duration::from_secs(1);

/// The reason why a node, publication, subscription or service cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    #[error(transparent)]
    Name(#[from] NameError),
    #[error("cannot listen at {address}: {source}; is it an address of this machine?")]
    Listen { address: SocketAddr, source: io::Error },
    #[error("{0} is published by this node already: publish by that `Publisher`, or drop it first")]
    Published(String),
    #[error("{0} is subscribed to by this node already: take from that `Subscription`, or drop it first")]
    Subscribed(String),
    #[error("{0} is served by this node already: drop that `ServiceServer` first")]
    Served(String),
    #[error("the type {0:?} is not of the form PACKAGE/NAME")]
    Type(String),
}

/// The error for a message that exceeds [`NodeConfig::max_message`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message of {length} bytes, and at most {max} are published: raise `max_message` if it was meant")]
pub struct TooLong {
    pub length: usize,
    pub max: usize,
}

/// A ROS 1 node. Dropping it ends all its publications, subscriptions and services, and unregisters
/// them in the background. [`Node::leave`] waits for that.
pub struct Node {
    shared: Arc<Shared>,
    /// Tasks of the two servers, which end when this is dropped.
    servers: JoinSet<()>,
    registrar: Option<JoinHandle<()>>,
}

impl Node {
    /// Starts to listen and connects to the master in the background; [`Node::status`] shows the
    /// result. Must be called within a tokio runtime.
    pub async fn start(config: NodeConfig) -> Result<Self, NodeError> {
        validate_node(&config.name)?;
        let poll = config.poll.clamp(POLL.0, POLL.1);
        let config = NodeConfig { poll, ..config };
        let (api, api_port) = bind(&config).await?;
        let (tcpros, port) = bind(&config).await?;
        let master = Master { uri: config.master_uri.clone(), caller_id: config.name.clone(), timeout: config.timeout };
        let shared = Arc::new(Shared {
            uri: format!("{}/", config.uri("http", api_port)),
            config,
            master,
            port,
            registrations: Mutex::new(Registrations::default()),
            wake: Notify::new(),
            publications: Mutex::default(),
            subscriptions: Mutex::default(),
            services: Mutex::default(),
            answers: Arc::default(),
            status: watch::Sender::default(),
            graph: watch::Sender::default(),
            leaving: watch::Sender::default(),
        });
        let mut servers = JoinSet::new();
        let answering = shared.clone();
        servers.spawn(server::serve(api, move |call| answering.answer(call)));
        let serving = shared.clone();
        servers.spawn(listen(tcpros, move |stream, header| serving.clone().serve(stream, header)));
        let registrar = Some(tokio::spawn(Registrar::new(shared.clone()).run()));
        Ok(Self { shared, servers, registrar })
    }

    /// Returns the global name of the node.
    pub fn name(&self) -> &str {
        &self.shared.config.name
    }

    /// Returns the URI of the slave API.
    pub fn uri(&self) -> &str {
        &self.shared.uri
    }

    /// Publishes a topic. A node can have only one `Publisher` per topic.
    pub fn publish(&self, topic: &str, kind: MessageType, options: PublishOptions) -> Result<Publisher, NodeError> {
        let topic = resolve(topic, self.name())?;
        validate_type(&kind.name)?;
        let publication = Publication::new(topic.clone(), kind, options, self.name().to_owned());
        let publication = Arc::new(publication);
        let mut publications = self.shared.publications.lock();
        if publications.contains_key(&topic) {
            return Err(NodeError::Published(topic));
        }
        publications.insert(topic.clone(), publication.clone());
        let kind = publication.kind.name.clone();
        let registered = Registered::new(&self.shared, (RegistrationKind::Publisher, topic), kind);
        Ok(Publisher { publication, registered })
    }

    /// Subscribes to a topic, of any type unless `options` specify one. A node can have only one
    /// `Subscription` per topic, and does not receive its own messages.
    pub fn subscribe(&self, topic: &str, options: SubscribeOptions) -> Result<Subscription, NodeError> {
        let topic = resolve(topic, self.name())?;
        let (kind, md5sum) = options.kind.unwrap_or_else(|| ("*".to_owned(), "*".to_owned()));
        if kind != "*" {
            validate_type(&kind)?;
        }
        let Shared { config, uri, .. } = &*self.shared;
        let common = Arc::new(Common {
            topic: topic.clone(),
            kind: kind.clone(),
            md5sum,
            caller_id: config.name.clone(),
            max_message: config.max_message,
            timeout: config.timeout,
            queue: Queue::new(options.queue),
        });
        let mut subscriptions = self.shared.subscriptions.lock();
        if subscriptions.contains_key(&topic) {
            return Err(NodeError::Subscribed(topic));
        }
        let (listed, of_master) = watch::channel(Listed::default());
        let (shown, states) = watch::channel(SourceStates::new());
        let sources = Sources::new(uri.clone());
        tokio::spawn(ConnectionSupervisor { common: common.clone(), sources, listed: of_master, states: shown }.run());
        subscriptions.insert(topic.clone(), Subscribed { kind: kind.clone(), listed, states: states.clone() });
        let registered = Registered::new(&self.shared, (RegistrationKind::Subscriber, topic), kind);
        Ok(Subscription { common, ended: states.clone(), states, registered })
    }

    /// Serves a service. At most `concurrency` calls of `handler` (at least 1) run at once; other
    /// requests wait. The caller receives the error text of `handler`.
    pub fn serve<F>(
        &self,
        service: &str,
        kind: ServiceType,
        concurrency: usize,
        handler: impl Fn(ServiceRequest) -> F + Send + Sync + 'static,
    ) -> Result<ServiceServer, NodeError>
    where
        F: Future<Output = Result<Bytes, String>> + Send + 'static,
    {
        let service = resolve(service, self.name())?;
        validate_type(&kind.name)?;
        let handler = Box::new(move |request| Box::pin(handler(request)) as _);
        let (caller_id, max_message) = (self.name().to_owned(), self.shared.config.max_message);
        let served = Service::new(
            service.clone(),
            kind,
            concurrency.max(1),
            caller_id,
            max_message,
            handler,
            self.shared.answers.clone(),
        );
        let mut services = self.shared.services.lock();
        if services.contains_key(&service) {
            return Err(NodeError::Served(service));
        }
        services.insert(service.clone(), Arc::new(served));
        Ok(ServiceServer {
            registered: Registered::new(&self.shared, (RegistrationKind::Service, service), String::new()),
        })
    }

    /// Returns a client of a service. Sends nothing yet.
    pub fn client(&self, service: &str) -> Result<ServiceClient, NodeError> {
        let service = resolve(service, self.name())?;
        Ok(ServiceClient { master: self.shared.master.clone(), service, max_message: self.shared.config.max_message })
    }

    /// Returns a watch on the graph of the master.
    pub fn graph(&self) -> Graph {
        Graph::new(self.shared.graph.subscribe())
    }

    /// Returns a watch on the state at the master.
    pub fn status(&self) -> watch::Receiver<Status> {
        self.shared.status.subscribe()
    }

    /// Unregisters everything at the master within a few seconds, and closes all connections.
    /// Service calls in progress have one second to finish first.
    pub async fn leave(mut self) {
        self.shared.leaving.send_replace(true);
        if let Some(registrar) = self.registrar.take() {
            // The registrar task ends by itself or has panicked; both cases need no action.
            _ = registrar.await;
        }
        _ = tokio::time::timeout(LAST_ANSWERS, self.shared.answers.write()).await;
        self.servers.shutdown().await;
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.shared.leaving.send_replace(true);
        // Handles may live longer than the node, so their connections end here.
        self.shared.publications.lock().clear();
        self.shared.subscriptions.lock().clear();
        self.shared.services.lock().clear();
    }
}

/// A registration that ends when its handle is dropped.
struct Registered {
    shared: Arc<Shared>,
    key: Key,
}

impl Registered {
    fn new(shared: &Arc<Shared>, key: Key, kind: String) -> Self {
        shared.register(|registrations| registrations.want(key.clone(), kind));
        Self { shared: shared.clone(), key }
    }
}

impl Drop for Registered {
    fn drop(&mut self) {
        // Holds the lock, so that a new handle of the same name registers only after this one has
        // unregistered.
        fn remove<T>(of: &Mutex<HashMap<String, T>>, name: &str, leave: impl FnOnce()) {
            let mut handles = of.lock();
            handles.remove(name);
            leave();
        }
        let leave = || self.shared.register(|registrations| registrations.leave(&self.key));
        let (kind, name) = &self.key;
        match kind {
            RegistrationKind::Publisher => remove(&self.shared.publications, name, leave),
            RegistrationKind::Subscriber => remove(&self.shared.subscriptions, name, leave),
            RegistrationKind::Service => remove(&self.shared.services, name, leave),
        }
    }
}

/// A topic that this node publishes until this handle is dropped. Dropping it discards all queued
/// messages.
pub struct Publisher {
    publication: Arc<Publication>,
    registered: Registered,
}

impl Publisher {
    /// Returns the global name of the topic.
    pub fn topic(&self) -> &str {
        &self.publication.topic
    }

    /// Queues a message for all subscribers, in ROS 1 serialization without the length prefix.
    /// Never waits: the queue of a slow subscriber drops and counts its oldest messages.
    pub fn publish(&self, message: Bytes) -> Result<(), TooLong> {
        let max = self.registered.shared.config.max_message;
        if message.len() > max {
            return Err(TooLong { length: message.len(), max });
        }
        self.publication.publish(message);
        Ok(())
    }

    /// Discards the latched message. New subscribers receive nothing until the next one is
    /// published.
    pub fn forget_latched(&self) {
        self.publication.forget_latched();
    }

    /// Returns the connected subscribers.
    pub fn subscribers(&self) -> Vec<Subscriber> {
        self.publication.connected()
    }

    /// Returns the number of messages that the queues of slow subscribers dropped.
    pub fn dropped(&self) -> u64 {
        self.publication.dropped()
    }
}

/// A topic that this node subscribes to until this handle is dropped.
pub struct Subscription {
    common: Arc<Common>,
    states: watch::Receiver<SourceStates>,
    /// A second receiver of `states`, which shows the end of the subscription.
    ended: watch::Receiver<SourceStates>,
    registered: Registered,
}

impl Subscription {
    /// Returns the global name of the topic.
    pub fn topic(&self) -> &str {
        &self.registered.key.1
    }

    /// Waits for the next message. Returns `None` when the node has left. This function is
    /// cancel-safe.
    pub async fn next(&mut self) -> Option<Message> {
        tokio::select! {
            biased;
            message = self.common.queue.pop() => Some(message),
            () = async { while self.ended.changed().await.is_ok() {} } => None,
        }
    }

    /// Returns a watch on the publishers of the topic and their connections.
    pub fn sources(&self) -> watch::Receiver<SourceStates> {
        self.states.clone()
    }

    /// Returns the number of messages that a full queue dropped.
    pub fn dropped(&self) -> u64 {
        self.common.queue.dropped()
    }
}

/// A service that this node serves until this handle is dropped. Calls in progress still finish.
pub struct ServiceServer {
    registered: Registered,
}

impl ServiceServer {
    /// Returns the global name of the service.
    pub fn service(&self) -> &str {
        &self.registered.key.1
    }
}

async fn bind(config: &NodeConfig) -> Result<(TcpListener, u16), NodeError> {
    let address = SocketAddr::new(config.bind, 0);
    let bound = async {
        let listener = TcpListener::bind(address).await?;
        let port = listener.local_addr()?.port();
        Ok((listener, port))
    };
    bound.await.map_err(|source| NodeError::Listen { address, source })
}

/// Masters refuse other types, and some break the connection header.
fn validate_type(kind: &str) -> Result<(), NodeError> {
    let is_part = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
    match kind.split_once('/') {
        Some((package, name)) if is_part(package) && is_part(name) => Ok(()),
        _ => Err(NodeError::Type(kind.to_owned())),
    }
}
