//! A topic that this node subscribes to: a connection to each publisher, and one queue for all
//! messages.

pub use crate::topic::message::{Message, PublisherInfo};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Instant;

use tokio::sync::{mpsc, watch};
use tokio::task::{AbortHandle, Id, JoinSet};

use super::link::{self, Common, LinkError};
use super::sources::{SourceAction, Sources};
use crate::queue::QueueLimits;

/// The options of a subscription.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SubscribeOptions {
    /// The type and MD5 sum that publishers must have, or `None` for any.
    pub kind: Option<(String, String)>,
    /// The limits of the queue of received messages.
    pub queue: QueueLimits,
}

/// The state of the connection to a publisher.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceState {
    Connecting,
    Connected(Arc<PublisherInfo>),
    /// The reason of the failure. The subscription tries again.
    Failed(String),
}

/// The states of all publishers of a topic, by the URIs of their slave APIs.
pub type SourceStates = BTreeMap<String, SourceState>;

/// The master's last list of a topic's publishers.
#[derive(Clone, Debug, Default)]
pub struct Listed {
    /// Number of times that the master has lost this subscription.
    pub run: u64,
    /// The version of the list, which rises with each one.
    pub version: u64,
    pub publishers: Vec<String>,
}

/// Connects to the publishers that the master lists. Ends when the sender of `listed` is dropped.
pub struct ConnectionSupervisor {
    pub common: Arc<Common>,
    pub sources: Sources,
    pub listed: watch::Receiver<Listed>,
    pub states: watch::Sender<SourceStates>,
}

type Ended = Result<std::convert::Infallible, LinkError>;

/// The connections, one task for each.
struct Links {
    tasks: JoinSet<Ended>,
    by_id: HashMap<Id, String>,
    by_uri: HashMap<String, AbortHandle>,
    connected: mpsc::Sender<Arc<PublisherInfo>>,
}

impl ConnectionSupervisor {
    pub async fn run(mut self) {
        let (connected, mut connections) = mpsc::channel(16);
        let mut links = Links { tasks: JoinSet::new(), by_id: HashMap::new(), by_uri: HashMap::new(), connected };
        loop {
            let due = self.sources.next_due();
            let actions = tokio::select! {
                // The start of a connection is handled before its end.
                biased;
                changed = self.listed.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    let Listed { run, publishers, .. } = self.listed.borrow_and_update().clone();
                    self.sources.listed(run, &publishers, Instant::now())
                }
                Some(info) = connections.recv() => {
                    self.connected(&links, info);
                    continue;
                }
                Some(ended) = links.tasks.join_next_with_id() => {
                    self.ended(&mut links, ended);
                    continue;
                }
                () = sleep_until(due) => self.sources.due(Instant::now()),
            };
            for action in actions {
                self.act(&mut links, action);
            }
        }
    }

    fn act(&mut self, links: &mut Links, action: SourceAction) {
        match action {
            SourceAction::Connect(publisher) => {
                let (common, uri, connected) = (self.common.clone(), publisher.clone(), links.connected.clone());
                let task = links.tasks.spawn(async move { link::run(&common, &uri, connected).await });
                links.by_id.insert(task.id(), publisher.clone());
                links.by_uri.insert(publisher.clone(), task);
                self.states.send_if_modified(|states| {
                    // The last error stays visible until the state changes.
                    let is_new = !states.contains_key(&publisher);
                    states.entry(publisher).or_insert(SourceState::Connecting);
                    is_new
                });
            }
            SourceAction::Drop(publisher) => {
                if let Some(task) = links.by_uri.remove(&publisher) {
                    links.by_id.remove(&task.id());
                    task.abort();
                }
                self.states.send_modify(|states| _ = states.remove(&publisher));
            }
        }
    }

    fn connected(&mut self, links: &Links, info: Arc<PublisherInfo>) {
        if links.by_uri.contains_key(&info.uri) {
            tracing::debug!(topic = self.common.topic, publisher = info.caller_id, "connected");
            self.sources.connected(&info.uri, Instant::now());
            self.states.send_modify(|states| _ = states.insert(info.uri.clone(), SourceState::Connected(info)));
        }
    }

    fn ended(&mut self, links: &mut Links, ended: Result<(Id, Ended), tokio::task::JoinError>) {
        let (id, reason) = match ended {
            Ok((id, Err(error))) => (id, error.to_string()),
            Ok((_, Ok(never))) => match never {},
            Err(error) => (error.id(), error.to_string()),
        };
        // A connection that was dropped on purpose has no entry any more.
        let Some(publisher) = links.by_id.remove(&id) else { return };
        links.by_uri.remove(&publisher);
        tracing::debug!(topic = self.common.topic, publisher, reason, "not connected");
        let again = self.sources.ended(&publisher, Instant::now());
        self.states.send_modify(|states| {
            if again {
                states.insert(publisher, SourceState::Failed(reason));
            } else {
                states.remove(&publisher);
            }
        });
    }
}

async fn sleep_until(instant: Option<Instant>) {
    match instant {
        Some(instant) => tokio::time::sleep_until(instant.into()).await,
        None => std::future::pending().await,
    }
}
