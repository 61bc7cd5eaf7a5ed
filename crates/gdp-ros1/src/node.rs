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

/// How often and how rarely a master may be asked for its state.
const POLL: (Duration, Duration) = (Duration::from_millis(50), Duration::from_secs(60));

/// Time for those who are being answered to get that before connections end.
const LAST_ANSWERS: Duration = Duration::from_secs(1);

/// Why a node, or something of it, cannot be.
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

/// A message is too long to be published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message of {length} bytes, and at most {max} are published: raise `max_message` if it was meant")]
pub struct TooLong {
    pub length: usize,
    pub max: usize,
}

/// A ROS 1 node. Ends with everything that it publishes, subscribes to and serves when it is
/// dropped; the master is told in the background then. [`Node::leave`] waits for that.
pub struct Node {
    shared: Arc<Shared>,
    /// The servers end when this is dropped.
    servers: JoinSet<()>,
    registrar: Option<JoinHandle<()>>,
}

impl Node {
    /// Begins to listen, and looks for the master in the background: whether it is there shows in
    /// [`Node::status`]. To be called within a tokio runtime.
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

    /// In full.
    pub fn name(&self) -> &str {
        &self.shared.config.name
    }

    /// Of the slave API.
    pub fn uri(&self) -> &str {
        &self.shared.uri
    }

    /// Publishes a topic. Only one `Publisher` of a node may have it.
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

    /// Subscribes to a topic, of whatever type unless `options` say which. Only one `Subscription`
    /// of a node may have it. What this node publishes itself does not come.
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

    /// Serves a service: `handler` is called with each request, at most `concurrency` (at least 1)
    /// at once; others wait. An error is told to the caller.
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

    /// To call a service with. Asks nobody yet.
    pub fn client(&self, service: &str) -> Result<ServiceClient, NodeError> {
        let service = resolve(service, self.name())?;
        Ok(ServiceClient { master: self.shared.master.clone(), service, max_message: self.shared.config.max_message })
    }

    /// Watches what is there at the master.
    pub fn graph(&self) -> Graph {
        Graph::new(self.shared.graph.subscribe())
    }

    /// How it stands with the master; changes can be waited for.
    pub fn status(&self) -> watch::Receiver<Status> {
        self.shared.status.subscribe()
    }

    /// Takes everything back at the master, as far as it can be reached within a few seconds, and
    /// ends all connections; those who are being answered get that before, if it takes no more than
    /// a second.
    pub async fn leave(mut self) {
        self.shared.leaving.send_replace(true);
        if let Some(registrar) = self.registrar.take() {
            // It ends by itself, or has panicked: either way nothing more can be done.
            _ = registrar.await;
        }
        _ = tokio::time::timeout(LAST_ANSWERS, self.shared.answers.write()).await;
        self.servers.shutdown().await;
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        self.shared.leaving.send_replace(true);
        // Handles may live on: what they stand for ends here.
        self.shared.publications.lock().clear();
        self.shared.subscriptions.lock().clear();
        self.shared.services.lock().clear();
    }
}

/// A registration that ends with its handle.
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
        // Under the lock, so that another of the same name is registered after this one is taken
        // back.
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

/// A topic that this node publishes, until it is dropped. What waits for subscribers then is lost.
pub struct Publisher {
    publication: Arc<Publication>,
    registered: Registered,
}

impl Publisher {
    /// In full.
    pub fn topic(&self) -> &str {
        &self.publication.topic
    }

    /// Hands a message, as serialized by ROS 1 without the length in front, to all who are
    /// connected. Does not wait: for those who are too slow, the oldest that wait are dropped and
    /// counted.
    pub fn publish(&self, message: Bytes) -> Result<(), TooLong> {
        let max = self.registered.shared.config.max_message;
        if message.len() > max {
            return Err(TooLong { length: message.len(), max });
        }
        self.publication.publish(message);
        Ok(())
    }

    /// Who comes from now on receives nothing, until something is published again.
    pub fn forget_latched(&self) {
        self.publication.forget_latched();
    }

    /// Those who are connected now.
    pub fn subscribers(&self) -> Vec<Subscriber> {
        self.publication.connected()
    }

    /// Messages that subscribers were too slow for, since the beginning.
    pub fn dropped(&self) -> u64 {
        self.publication.dropped()
    }
}

/// A topic that this node subscribes to, until it is dropped.
pub struct Subscription {
    common: Arc<Common>,
    states: watch::Receiver<SourceStates>,
    /// The same, for what it says when it ends.
    ended: watch::Receiver<SourceStates>,
    registered: Registered,
}

impl Subscription {
    /// In full.
    pub fn topic(&self) -> &str {
        &self.registered.key.1
    }

    /// Waits for the next message; `None` when the node has left. It may be dropped while it waits,
    /// without a loss.
    pub async fn next(&mut self) -> Option<Message> {
        tokio::select! {
            biased;
            message = self.common.queue.pop() => Some(message),
            () = async { while self.ended.changed().await.is_ok() {} } => None,
        }
    }

    /// Who publishes the topic, and whether they are connected; changes can be waited for.
    pub fn sources(&self) -> watch::Receiver<SourceStates> {
        self.states.clone()
    }

    /// Messages that were not taken in time, since the beginning.
    pub fn dropped(&self) -> u64 {
        self.common.queue.dropped()
    }
}

/// A service that this node serves, until it is dropped. Calls that run then are answered.
pub struct ServiceServer {
    registered: Registered,
}

impl ServiceServer {
    /// In full.
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

/// Masters refuse other types, and headers end at the wrong place with some.
fn validate_type(kind: &str) -> Result<(), NodeError> {
    let is_part = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
    match kind.split_once('/') {
        Some((package, name)) if is_part(package) && is_part(name) => Ok(()),
        _ => Err(NodeError::Type(kind.to_owned())),
    }
}
