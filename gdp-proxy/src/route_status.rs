//! State that topics, services, actions and catalogs share: the right of the route, its progress,
//! and why it ends.

use std::fmt::Display;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use gdp::{Ended, NodeError};
use gdp_core::cert::{AdCert, Issued, Reading};
use gdp_util::backoff::Backoff;
use gdp_wire::Name;
use parking_lot::{Mutex, MutexGuard};
use tokio::time::{Interval, MissedTickBehavior};

use crate::config::Side;
use crate::graph::GraphError;
use crate::manager::Failure;
use crate::peer_proxies::RoutePart;
use crate::permission::Permission;
use crate::renewal::Renewal;

/// How often it is looked for another certificate, and for what else time brings.
const LOOK: Duration = Duration::from_secs(1);

/// Before a name is asked for again that was refused.
pub const RETRY: Backoff = Backoff::new(Duration::from_millis(500), Duration::from_secs(30));

/// A right to a name, and where it came from.
pub struct Right<T> {
    current: T,
    file: Renewal,
    of: fn(Permission) -> Option<T>,
}

/// The right to one direction.
pub enum EitherRight {
    Publish(Right<Issued<AdCert>>),
    Read(Right<Reading>),
}

impl EitherRight {
    pub fn new(permission: Permission, file: Renewal) -> Self {
        match permission {
            Permission::Publish(cert) => Self::Publish(Right::publish(cert, file)),
            Permission::Read(grant) => Self::Read(Right::read(grant, file)),
        }
    }
}

impl Right<Issued<AdCert>> {
    /// To publish or serve it.
    pub fn publish(current: Issued<AdCert>, file: Renewal) -> Self {
        Self { current, file, of: Permission::publish }
    }
}

impl Right<Reading> {
    /// To read or call it.
    pub fn read(current: Reading, file: Renewal) -> Self {
        Self { current, file, of: Permission::read }
    }
}

impl<T: Clone> Right<T> {
    /// What it is at the moment.
    pub fn current(&self) -> T {
        self.current.clone()
    }

    /// Another one than that, if there is one.
    fn newer(&mut self) -> Option<T> {
        self.file.changed().and_then(self.of)
    }
}

/// How far something has come, for the log, people and tests.
pub struct RouteStatus {
    /// `topic /chatter`
    title: String,
    name: Name,
    progress: Mutex<Progress>,
    /// It has ended by itself before.
    has_failed: AtomicBool,
}

struct Progress {
    kind: Option<String>,
    status: String,
}

impl RouteStatus {
    /// `kind`: the ROS type, if it is known.
    pub fn new(title: String, name: Name, kind: Option<String>) -> Self {
        Self {
            title,
            name,
            progress: Mutex::new(Progress { kind, status: "starting".into() }),
            has_failed: AtomicBool::new(false),
        }
    }

    pub fn name(&self) -> Name {
        self.name
    }

    pub fn title(&self) -> &str {
        &self.title
    }

    /// For the other proxies of its graph.
    pub fn part(&self, side: Side) -> RoutePart {
        RoutePart { name: self.name, side, title: self.title.clone() }
    }

    /// The ROS type, as its graph calls it, as soon as it is known.
    pub fn kind(&self) -> Option<String> {
        self.progress().kind.clone()
    }

    /// `up`, or what it waits for.
    pub fn status(&self) -> String {
        self.progress().status.clone()
    }

    /// Whether it has ended by itself before.
    pub fn has_failed(&self) -> bool {
        self.has_failed.load(Relaxed)
    }

    pub fn set_kind(&self, kind: &str) {
        self.progress().kind = Some(kind.into());
    }

    pub fn set_status(&self, status: &str) {
        self.progress().status = status.into();
    }

    pub fn is_up(&self) {
        tracing::info!(what = %self.title, name = %self.name, "carrying");
        self.set_status("up");
    }

    /// It ended by itself, and is begun again after a while.
    pub fn failed(&self, why: &str) {
        self.has_failed.store(true, Relaxed);
        tracing::warn!(what = %self.title, name = %self.name, "not carried: {why}; beginning again in a while");
        self.set_status(why);
    }

    /// Waits until the name is to be asked for again, by another right if there is one by then. A
    /// refusal is no reason to end: others may be fine, and owners, RIBs and clocks mend.
    pub async fn pause<T: Clone>(&self, error: impl Display, retry: &mut Backoff, right: &mut Right<T>) {
        let (message, delay) = (error.to_string(), retry.next_delay());
        tracing::warn!(what = %self.title, name = %self.name, "{message}; trying again in {delay:?}");
        self.set_status(&message);
        tokio::time::sleep(delay).await;
        if let Some(new) = right.newer() {
            right.current = new;
            right.file.taken();
        }
    }

    /// Has another certificate put in force, if there is one: by `show`, which shows it to the RIB.
    pub async fn renew<T: Clone>(&self, right: &mut Right<T>, show: impl AsyncFnOnce(T) -> Result<(), NodeError>) {
        let Some(new) = right.newer() else { return };
        match show(new.clone()).await {
            Ok(()) => {
                right.current = new;
                right.file.taken();
                tracing::info!(what = %self.title, name = %self.name, "the certificate was renewed");
            }
            Err(error) => right.file.refused(&error),
        }
    }

    /// As [managers](crate::manager) are to take the end.
    pub fn ended(&self, error: RouteError) -> Failure {
        match error {
            RouteError::NodeClosed | RouteError::Graph(GraphError::Left) => {
                Failure::Final(anyhow::anyhow!(error).context(self.title.clone()))
            }
            error => Failure::Passing(error.to_string()),
        }
    }

    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock()
    }
}

/// Why something does not cross any more.
#[derive(Debug, thiserror::Error)]
pub enum RouteError {
    #[error(transparent)]
    Graph(#[from] GraphError),
    #[error(transparent)]
    Cbor(#[from] gdp_core::cbor::CborError),
    #[error("the node is closed")]
    NodeClosed,
}

/// What has ended the right to a name, unless all has ended.
pub fn ended_because(why: Ended) -> Result<NodeError, RouteError> {
    match why {
        Ended::Right(error) => Ok(error.into()),
        Ended::Closed => Err(RouteError::NodeClosed),
    }
}

pub fn ticks() -> Interval {
    let mut ticks = tokio::time::interval(LOOK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}
