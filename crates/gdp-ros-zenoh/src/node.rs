//! A client of a Zenoh router that takes part in the graph of one domain.
//!
//! No function waits for the router. A task connects, and Zenoh connects again whenever the session
//! loses its router. Until the first connection there is no graph, and nothing can be created.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp_util::line_limit::LineLimit;
use parking_lot::Mutex;
use tokio::sync::{Notify, mpsc, watch};
use tokio::task::JoinHandle;
use zenoh::Wait;
use zenoh::config::EndPoint;
use zenoh::sample::{Locality, Sample, SampleKind};

use crate::MAX_MESSAGE;
use crate::roll::Roll;
use crate::table::{Snapshot, Table};
use crate::token::ADMIN;

/// Time between two attempts to reach the router.
const RETRY: Duration = Duration::from_secs(1);

/// Shortest time between two snapshots, because a node announces a dozen endpoints at once.
const PACE: Duration = Duration::from_millis(50);

/// Bound on the messages that wait in the side channel.
const SIDE: usize = 64;

/// Bound on a message of the side channel in bytes.
const MAX_SIDE: usize = 4 << 20;

/// One line about malformed tokens in each period.
static TOKENS: LineLimit = LineLimit::new(1, Duration::from_secs(60));

/// The address of a router, such as `tcp/localhost:7447`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Locator(EndPoint);

/// A text that is no address of a router.
#[derive(Debug, thiserror::Error)]
#[error("{text:?} is no locator of a router, such as tcp/localhost:7447: {why}")]
pub struct LocatorError {
    text: String,
    why: String,
}

/// Reasons for which an endpoint cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum ZenohError {
    #[error("the Zenoh router at {0} is not reached yet; does it run (`ros2 run rmw_zenoh_cpp rmw_zenohd`)?")]
    Unreached(String),
    #[error("Zenoh: {0}")]
    Zenoh(#[from] zenoh::Error),
}

/// A node in the graph, until it [leaves](Self::leave).
pub struct ZenohNode {
    shared: Arc<NodeState>,
    locator: Locator,
    tasks: Vec<JoinHandle<()>>,
    side_key: String,
}

struct NodeState {
    roll: OnceLock<Arc<Roll>>,
    table: Mutex<Table>,
    /// Notified when the table changes.
    news: Notify,
    graph: watch::Sender<Arc<Snapshot>>,
}

impl Locator {
    pub fn parse(text: &str) -> Result<Self, LocatorError> {
        let refused = |why: String| LocatorError { text: text.to_owned(), why };
        match text.parse::<EndPoint>() {
            Ok(locator) if locator.protocol().as_str() == "tcp" => Ok(Self(locator)),
            Ok(other) => Err(refused(format!("{} is not built in, only tcp is", other.protocol()))),
            Err(error) => Err(refused(error.to_string())),
        }
    }
}

impl ZenohNode {
    /// Starts the node `name` in the root namespace. The second value receives what others publish
    /// under the key `side`, which ROS does not use. Needs a multi-threaded tokio runtime.
    pub fn start(locator: Locator, domain: u32, name: &str, side: &str) -> (Self, mpsc::Receiver<Bytes>) {
        let shared = Arc::new(NodeState {
            roll: OnceLock::new(),
            table: Mutex::default(),
            news: Notify::new(),
            graph: watch::Sender::default(),
        });
        let (to_side, side_messages) = mpsc::channel(SIDE);
        let connector = Connector {
            shared: shared.clone(),
            locator: locator.clone(),
            domain,
            name: name.to_owned(),
            side: side.to_owned(),
            to_side,
        };
        let tasks = vec![tokio::spawn(connector.run()), tokio::spawn(follow(shared.clone()))];
        (Self { shared, locator, tasks, side_key: side.to_owned() }, side_messages)
    }

    /// Returns the entities of other sessions, with every change.
    pub fn graph(&self) -> watch::Receiver<Arc<Snapshot>> {
        self.shared.graph.subscribe()
    }

    /// Returns a function that publishes in the side channel, if the router is reached.
    pub fn teller(&self) -> impl Fn(String) -> Result<(), ZenohError> + Send + Sync + use<> {
        let (shared, key) = (self.shared.clone(), self.side_key.clone());
        move |text| match shared.roll.get() {
            Some(roll) => Ok(roll.session().put(key.as_str(), text).wait()?),
            None => Ok(()),
        }
    }

    pub(crate) fn roll(&self) -> Result<&Arc<Roll>, ZenohError> {
        self.shared.roll.get().ok_or_else(|| ZenohError::Unreached(self.locator.0.to_string()))
    }

    /// Ends the session, so that others see its nodes leave.
    pub async fn leave(self) {
        for task in self.tasks {
            task.abort();
            _ = task.await;
        }
        if let Some(roll) = self.shared.roll.get()
            && let Err(error) = roll.session().close().await
        {
            tracing::debug!("the Zenoh session did not end properly: {error}");
        }
    }
}

/// What the task needs that connects.
struct Connector {
    shared: Arc<NodeState>,
    locator: Locator,
    domain: u32,
    name: String,
    side: String,
    to_side: mpsc::Sender<Bytes>,
}

impl Connector {
    async fn run(self) {
        let mut has_warned = false;
        loop {
            match self.enter().await {
                Ok(()) => break,
                Err(error) if !std::mem::replace(&mut has_warned, true) => {
                    tracing::warn!(router = %self.locator.0, "the Zenoh router is not reached, trying on: {error}");
                }
                Err(error) => tracing::debug!(router = %self.locator.0, "the Zenoh router is not reached: {error}"),
            }
            tokio::time::sleep(RETRY).await;
        }
        tracing::info!(router = %self.locator.0, "joined a graph of rmw_zenoh");
    }

    async fn enter(&self) -> zenoh::Result<()> {
        let session = zenoh::open(self.config()?).await?;
        let roll = Arc::new(Roll::new(session.clone(), self.domain, &self.name));
        // Other bridges recognise this one by its node, and ignore its endpoints.
        roll.enter()?;
        let (shared, own) = (self.shared.clone(), session.zid().to_string());
        let tokens = format!("{ADMIN}/{}/**", self.domain);
        let changed = move |sample: Sample| shared.change(&own, &sample);
        let liveliness = session.liveliness();
        liveliness.declare_subscriber(tokens).history(true).callback(changed).background().await?;
        let to_side = self.to_side.clone();
        let side = move |sample: Sample| {
            if sample.payload().len() <= MAX_SIDE {
                // The text comes again soon.
                _ = to_side.try_send(sample.payload().to_bytes().into_owned().into());
            }
        };
        let subscriber = session.declare_subscriber(self.side.clone()).allowed_origin(Locality::Remote);
        subscriber.callback(side).background().await?;
        _ = self.shared.roll.set(roll);
        Ok(())
    }

    fn config(&self) -> zenoh::Result<zenoh::Config> {
        let mut config = zenoh::Config::default();
        let endpoints = format!("[\"{}\"]", self.locator.0);
        let limit = (MAX_MESSAGE + MAX_SIDE).to_string();
        for (key, value) in [
            ("mode", "\"client\""),
            ("connect/endpoints", endpoints.as_str()),
            ("scouting/multicast/enabled", "false"),
            ("scouting/gossip/enabled", "false"),
            // rmw_zenoh needs the times of messages, for those that are transient-local.
            ("timestamping/enabled", "true"),
            ("transport/link/rx/max_message_size", limit.as_str()),
        ] {
            config.insert_json5(key, value)?;
        }
        Ok(config)
    }
}

impl NodeState {
    /// Receives the begin or the end of a token.
    fn change(&self, own: &str, sample: &Sample) {
        let text = sample.key_expr().as_str();
        let mut table = self.table.lock();
        if sample.kind() == SampleKind::Delete {
            table.remove(text);
        } else if text.split('/').nth(2) == Some(own) {
            return;
        } else if let Err(error) = table.insert(text) {
            if let Some(more) = TOKENS.take(Instant::now()) {
                tracing::warn!(more, "{error}: {}", text.get(..200).unwrap_or(text).escape_default());
            }
            return;
        }
        self.news.notify_one();
    }
}

/// Publishes a snapshot after changes.
async fn follow(shared: Arc<NodeState>) {
    loop {
        shared.news.notified().await;
        tokio::time::sleep(PACE).await;
        let snapshot = shared.table.lock().snapshot();
        shared.graph.send_replace(Arc::new(snapshot));
    }
}
