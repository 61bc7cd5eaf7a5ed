//! State that the tasks and handles of one node share.

use std::collections::HashMap;
use std::sync::Arc;

use parking_lot::{Mutex, MutexGuard};
use tokio::sync::{Notify, watch};

use crate::api::master::{Master, MasterError};
use crate::api::slave::{SlaveCall, failure, success};
use crate::config::NodeConfig;
use crate::graph::Snapshot;
use crate::registration::{Key, RegistrationKind, Registrations};
use crate::service::server::{Answers, Service};
use crate::tcpros::listener::refuse;
use crate::tcpros::{Header, Stream, TcprosError};
use crate::topic::publication::Publication;
use crate::topic::subscription::{Listed, PublisherInfo, SourceState, SourceStates};
use crate::xmlrpc::Value;

pub struct Shared {
    pub config: NodeConfig,
    pub master: Master,
    /// The URI of the slave API.
    pub uri: String,
    /// The TCPROS port.
    pub port: u16,
    pub registrations: Mutex<Registrations>,
    /// Notified when there is a new call to make to the master.
    pub wake: Notify,
    pub publications: Mutex<HashMap<String, Arc<Publication>>>,
    pub subscriptions: Mutex<HashMap<String, Subscribed>>,
    pub services: Mutex<HashMap<String, Arc<Service>>>,
    /// Locks of the calls in progress at all services, including dropped ones.
    pub answers: Answers,
    pub status: watch::Sender<Status>,
    pub graph: watch::Sender<Arc<Snapshot>>,
    /// Whether the node is leaving.
    pub leaving: watch::Sender<bool>,
}

/// A subscription, as the slave API and the master need it.
pub struct Subscribed {
    pub kind: String,
    pub listed: watch::Sender<Listed>,
    pub states: watch::Receiver<SourceStates>,
}

/// The state of a node at its master.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Status {
    pub master: MasterState,
    /// Number of registrations that the master has not accepted yet, or refuses.
    pub pending: usize,
    /// Names of topics and services that the master refuses, with its reasons. The node tries again
    /// at each poll.
    pub refused: Vec<(String, String)>,
    /// The reason of a request to shut down this node, from `rosnode kill` or from a master where
    /// another node took its name. The application decides what to do.
    pub shutdown: Option<String>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum MasterState {
    /// The node has not contacted the master yet.
    #[default]
    Unknown,
    Reached,
    /// The master is unreachable, with the reason. Existing connections stay. The node registers
    /// everything when the master is back.
    Unreachable(String),
    /// Another node has registered this node's name; the value is the URI of its slave API. This
    /// node waits until the name is free.
    NameTaken(String),
}

impl Shared {
    pub fn registrations(&self) -> MutexGuard<'_, Registrations> {
        self.registrations.lock()
    }

    /// Changes the registrations and wakes the registrar.
    pub fn register(&self, change: impl FnOnce(&mut Registrations)) {
        let pending = {
            let mut registrations = self.registrations();
            change(&mut registrations);
            registrations.pending()
        };
        self.status.send_if_modified(|status| std::mem::replace(&mut status.pending, pending) != pending);
        self.wake.notify_one();
    }

    pub fn set_master(&self, state: MasterState) {
        let (pending, refused) = {
            let registrations = self.registrations();
            (registrations.pending(), registrations.refusals())
        };
        let refused = refused.into_iter().map(|((_, name), reason)| (name, reason)).collect();
        self.status.send_if_modified(|status| {
            let now = Status { master: state, pending, refused, shutdown: status.shutdown.clone() };
            if now.master != status.master {
                match &now.master {
                    MasterState::Unknown => {}
                    MasterState::Reached => tracing::info!(uri = self.master.uri, "the master answers"),
                    MasterState::Unreachable(reason) => tracing::warn!("{reason}"),
                    MasterState::NameTaken(by) => {
                        tracing::warn!(name = self.config.name, by, "another node has taken this node's name");
                    }
                }
            }
            let is_new = now != *status;
            *status = now;
            is_new
        });
    }

    /// Stores the publishers of a topic. `asked` is the version of the list when the node called
    /// the master. If a `publisherUpdate` has arrived since, that list is newer and stays.
    pub fn listed(&self, topic: &str, publishers: Vec<String>, asked: Option<u64>) {
        let run = self.registrations().run_of(&(RegistrationKind::Subscriber, topic.to_owned()));
        let subscriptions = self.subscriptions.lock();
        let Some(subscribed) = subscriptions.get(topic) else { return };
        subscribed.listed.send_if_modified(|listed| {
            let is_newer = asked.is_none_or(|asked| asked == listed.version);
            if is_newer {
                *listed = Listed { run, version: listed.version + 1, publishers };
            }
            is_newer
        });
    }

    /// Returns the version of the list of a topic's publishers.
    pub fn version(&self, topic: &str) -> u64 {
        self.subscriptions.lock().get(topic).map_or(0, |subscribed| subscribed.listed.borrow().version)
    }

    /// Returns the publishers that this node's subscriptions are connected to, each with its topic.
    pub fn connected(&self) -> Vec<(String, Arc<PublisherInfo>)> {
        let mut connected = Vec::new();
        for (topic, subscribed) in self.subscriptions.lock().iter() {
            for state in subscribed.states.borrow().values() {
                if let SourceState::Connected(publisher) = state {
                    connected.push((topic.clone(), publisher.clone()));
                }
            }
        }
        connected
    }

    /// Passes a TCPROS connection to the topic or service that its header names.
    pub async fn serve(self: Arc<Self>, stream: Stream, header: Header) -> Result<(), TcprosError> {
        if let Some(service) = header.get("service") {
            let found = self.services.lock().get(service).cloned();
            return match found {
                Some(found) => found.serve(stream, header).await,
                None => refuse(stream, &format!("{} does not serve {service}", self.config.name)).await,
            };
        }
        let Some(topic) = header.get("topic") else {
            return refuse(stream, "Missing required 'topic' or 'service' field").await;
        };
        let found = self.publications.lock().get(topic).cloned();
        match found {
            Some(found) => found.serve(stream, header).await,
            None => refuse(stream, &format!("{} does not publish {topic}", self.config.name)).await,
        }
    }

    /// Executes a call of the slave API and returns the response.
    pub fn answer(&self, call: SlaveCall) -> Value {
        match call {
            SlaveCall::Pid => success("", std::process::id() as i32),
            SlaveCall::MasterUri => success("", self.master.uri.as_str()),
            SlaveCall::ParamUpdate => success("", 0),
            SlaveCall::PublisherUpdate { topic, publishers } => {
                self.listed(&topic, publishers, None);
                success("", 0)
            }
            SlaveCall::RequestTopic { topic, protocols, .. } => {
                if !self.publications.lock().contains_key(&topic) {
                    return failure(0, &format!("{} does not publish {topic}", self.config.name));
                }
                if !protocols.iter().any(|protocol| protocol == "TCPROS") {
                    return failure(0, "only TCPROS is spoken here");
                }
                let params = vec!["TCPROS".into(), self.config.host.as_str().into(), i32::from(self.port).into()];
                success("", params)
            }
            SlaveCall::Publications => {
                let publications = self.publications.lock();
                success("", topics(publications.values().map(|p| (p.topic.as_str(), p.kind.name.as_str()))))
            }
            SlaveCall::Subscriptions => {
                let subscriptions = self.subscriptions.lock();
                success("", topics(subscriptions.iter().map(|(topic, s)| (topic.as_str(), s.kind.as_str()))))
            }
            SlaveCall::BusInfo => success("", self.bus_info()),
            // Empty lists for publications, subscriptions and services. The node has no counters of
            // the kind that this call reports.
            SlaveCall::BusStats => success("", vec![Value::Array(vec![]), Value::Array(vec![]), Value::Array(vec![])]),
            SlaveCall::Shutdown { caller, reason } => {
                let text = if reason.is_empty() { format!("by {caller}") } else { format!("by {caller}: {reason}") };
                tracing::warn!(text, "asked to shut down");
                self.status.send_modify(|status| status.shutdown = Some(text));
                success("", 0)
            }
        }
    }

    /// Returns the connections as `rosnode info` shows them: number, peer, direction, transport,
    /// topic, connected.
    fn bus_info(&self) -> Vec<Value> {
        let mut connections = Vec::new();
        let mut add = |peer: &str, direction: &str, topic: &str, is_connected: bool| {
            let number = connections.len() as i32;
            let connected: [Value; 6] =
                [number.into(), peer.into(), direction.into(), "TCPROS".into(), topic.into(), is_connected.into()];
            connections.push(Value::Array(connected.into()));
        };
        for publication in self.publications.lock().values() {
            for subscriber in publication.connected() {
                add(&subscriber.caller_id, "o", &publication.topic, true);
            }
        }
        for (topic, subscribed) in self.subscriptions.lock().iter() {
            for (uri, state) in subscribed.states.borrow().iter() {
                add(uri, "i", topic, matches!(state, SourceState::Connected(_)));
            }
        }
        connections
    }

    /// Registers at the master. Stores the publishers that the master returns for a subscription.
    pub async fn register_at_master(&self, key: &Key, kind: &str) -> Result<(), MasterError> {
        let (of, name) = key;
        match of {
            RegistrationKind::Publisher => self.master.register_publisher(name, kind, &self.uri).await.map(drop),
            RegistrationKind::Service => self.master.register_service(name, &self.service_uri(), &self.uri).await,
            RegistrationKind::Subscriber => {
                let asked = self.version(name);
                let publishers = self.master.register_subscriber(name, kind, &self.uri).await?;
                self.listed(name, publishers, Some(asked));
                Ok(())
            }
        }
    }

    pub async fn unregister_at_master(&self, (kind, name): &Key) -> Result<(), MasterError> {
        match kind {
            RegistrationKind::Publisher => self.master.unregister_publisher(name, &self.uri).await,
            RegistrationKind::Subscriber => self.master.unregister_subscriber(name, &self.uri).await,
            RegistrationKind::Service => self.master.unregister_service(name, &self.service_uri()).await,
        }
    }

    fn service_uri(&self) -> String {
        self.config.uri("rosrpc", self.port)
    }
}

fn topics<'a>(topics: impl Iterator<Item = (&'a str, &'a str)>) -> Vec<Value> {
    topics.map(|(topic, kind)| Value::array([topic, kind])).collect()
}
