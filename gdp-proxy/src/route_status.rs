//! State that topics, services, actions and catalogs share: the certificate of the route, its
//! progress, and the reason of its end.

use std::fmt::Display;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use gdp::unstable::{Ended, NodeError};
use gdp_core::cert::{AdCert, Issued, Reading};
use gdp_util::backoff::Backoff;
use gdp_util::line_limit::LineLimit;
use gdp_util::ticks::Ticks;
use gdp_wire::Name;
use parking_lot::{Mutex, MutexGuard};

use crate::config::Side;
use crate::graph::GraphError;
use crate::manager::Failure;
use crate::peer_proxies::RoutePart;
use crate::permission::Permission;
use crate::renewal::Renewal;
use crate::waiting::{WaitLog, Waiting};

/// How often a route looks for a renewed certificate and does its other periodic work.
const LOOK: Duration = Duration::from_secs(1);

/// The log lines of refused requests, of all routes: a RIB that fails refuses every name.
static RETRIES: LineLimit = LineLimit::new(10, Duration::from_secs(60));

/// The log lines of what routes wait for, of all routes.
static WAITS: LineLimit = LineLimit::new(20, Duration::from_secs(60));

/// Begins the status of a route that another proxy of the graph carries.
pub const STANDING_BY: &str = "standing by";

/// Backoff between requests for a name that was refused.
pub const RETRY: Backoff = Backoff::new(Duration::from_millis(500), Duration::from_secs(30));

/// A certificate for a name, with the source of its renewals.
pub struct Right<T> {
    current: T,
    file: Renewal,
    of: fn(Permission) -> Option<T>,
}

/// A certificate for one of the two directions.
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
    /// A certificate to publish or serve the name.
    pub fn publish(current: Issued<AdCert>, file: Renewal) -> Self {
        Self { current, file, of: Permission::publish }
    }
}

impl Right<Reading> {
    /// A certificate to read or call the name.
    pub fn read(current: Reading, file: Renewal) -> Self {
        Self { current, file, of: Permission::read }
    }
}

impl<T: Clone> Right<T> {
    /// Returns the current certificate.
    pub fn current(&self) -> T {
        self.current.clone()
    }

    /// Returns a certificate that differs from the current one, if there is one, and its end.
    fn newer(&mut self) -> Option<(T, Option<u64>)> {
        let permission = self.file.changed()?;
        let until = permission.until();
        Some(((self.of)(permission)?, until))
    }
}

/// Progress of a route, for the log, people and tests.
pub struct RouteStatus {
    /// Kind and name, such as `topic /chatter`.
    title: String,
    name: Name,
    progress: Mutex<Progress>,
    wait: Mutex<WaitLog>,
    /// True once the route has ended by itself.
    has_failed: AtomicBool,
    /// When the certificate ends, in Unix seconds; 0 if that is not known.
    until: AtomicU64,
}

struct Progress {
    kind: Option<String>,
    status: String,
    /// Whether the last request for the name was refused.
    is_refused: bool,
}

impl RouteStatus {
    /// `kind` is the ROS type, if it is known. `until` is the end of the route's certificate.
    pub fn new(title: String, name: Name, kind: Option<String>, until: Option<u64>) -> Self {
        Self {
            title,
            name,
            progress: Mutex::new(Progress { kind, status: "starting".into(), is_refused: false }),
            wait: Mutex::new(WaitLog::default()),
            has_failed: AtomicBool::new(false),
            until: AtomicU64::new(until.unwrap_or(0)),
        }
    }

    pub fn name(&self) -> Name {
        self.name
    }

    pub fn title(&self) -> &str {
        &self.title
    }

    /// Returns the key under which the proxies of a graph share the route in this direction.
    pub fn part(&self, side: Side) -> RoutePart {
        RoutePart { name: self.name, side, title: self.title.clone() }
    }

    /// Returns the ROS type, as its graph writes it, once it is known.
    pub fn kind(&self) -> Option<String> {
        self.progress().kind.clone()
    }

    /// Returns `up`, or what the route waits for.
    pub fn status(&self) -> String {
        self.progress().status.clone()
    }

    /// Returns when the route's certificate ends, in Unix seconds, if that is known.
    pub fn certificate_until(&self) -> Option<u64> {
        Some(self.until.load(Relaxed)).filter(|until| *until > 0)
    }

    /// Whether the route has ended by itself before.
    pub fn has_failed(&self) -> bool {
        self.has_failed.load(Relaxed)
    }

    pub fn set_kind(&self, kind: &str) {
        self.progress().kind = Some(kind.into());
    }

    pub fn set_status(&self, status: &str) {
        self.progress().status = status.into();
    }

    /// Logs and shows that the route carries messages.
    pub fn is_up(&self) {
        tracing::info!(what = %self.title, name = %self.name, "carrying");
        self.progress().is_refused = false;
        self.set_status("up");
    }

    /// Returns what the route waits for, as of the last [`Self::look`].
    pub fn waiting_for(&self) -> Option<Waiting> {
        self.wait.lock().current()
    }

    /// Records what the route waits for: the switch, permission, or else what `otherwise` returns.
    /// Logs it once if it lasts; `detail` completes that line.
    pub fn look(
        &self,
        now: Instant,
        is_attached: bool,
        otherwise: impl FnOnce() -> Option<Waiting>,
        detail: impl FnOnce(Waiting) -> String,
    ) {
        let (is_refused, stands_by) = {
            let progress = self.progress();
            (progress.is_refused, progress.status.starts_with(STANDING_BY))
        };
        let waiting = match () {
            () if stands_by => None,
            () if !is_attached => Some(Waiting::Switch),
            () if is_refused => Some(Waiting::Permission),
            () => otherwise(),
        };
        let is_due = self.wait.lock().look(now, waiting);
        let Some(waiting) = waiting.filter(|_| is_due) else { return };
        let line = || format!("{} of {}{}", waiting.as_str(), self.title, detail(waiting));
        match WAITS.take(now) {
            Some(0) => tracing::info!(name = %self.name, "{}", line()),
            Some(more) => tracing::info!(name = %self.name, "{}; {more} such lines were not logged", line()),
            // The status of the route has it.
            None => {}
        }
    }

    /// Records that the route ended by itself. The manager starts it again after a while.
    pub fn failed(&self, why: &str) {
        self.has_failed.store(true, Relaxed);
        tracing::warn!(what = %self.title, name = %self.name, "not carried: {why}; beginning again in a while");
        self.set_status(why);
    }

    /// Waits for the backoff before the next request for the name, and then switches to a renewed
    /// certificate if there is one. A refusal does not end the route: other routes may work, and
    /// the owner, RIB or clock may recover.
    pub async fn pause<T: Clone>(&self, error: impl Display, retry: &mut Backoff, right: &mut Right<T>) {
        let (message, delay) = (error.to_string(), retry.next_delay());
        match RETRIES.take(Instant::now()) {
            Some(0) => tracing::warn!(what = %self.title, name = %self.name, "{message}; trying again in {delay:?}"),
            Some(more) => tracing::warn!(
                what = %self.title, name = %self.name,
                "{message}; trying again in {delay:?}; {more} such lines were not logged since the last one",
            ),
            // The status of the route has it.
            None => tracing::debug!(what = %self.title, name = %self.name, "{message}; trying again in {delay:?}"),
        }
        self.progress().is_refused = true;
        self.set_status(&message);
        tokio::time::sleep(delay).await;
        if let Some((new, until)) = right.newer() {
            right.current = new;
            right.file.taken();
            self.until.store(until.unwrap_or(0), Relaxed);
        }
    }

    /// Puts a renewed certificate in force, if there is one. `show` presents it to the RIB.
    pub async fn renew<T: Clone>(&self, right: &mut Right<T>, show: impl AsyncFnOnce(T) -> Result<(), NodeError>) {
        let Some((new, until)) = right.newer() else { return };
        match show(new.clone()).await {
            Ok(()) => {
                right.current = new;
                right.file.taken();
                self.until.store(until.unwrap_or(0), Relaxed);
                tracing::info!(what = %self.title, name = %self.name, "the certificate was renewed");
            }
            Err(error) => right.file.refused(&error),
        }
    }

    /// Classifies the error for the [manager](crate::manager): final, or to be retried.
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

/// Why a route ended by itself.
#[derive(Debug, thiserror::Error)]
pub enum RouteError {
    #[error(transparent)]
    Graph(#[from] GraphError),
    #[error(transparent)]
    Cbor(#[from] gdp_core::cbor::CborError),
    #[error("the node is closed")]
    NodeClosed,
}

/// Returns the error that ended the right to a name, or [`RouteError::NodeClosed`] if the node is
/// closed.
pub fn ended_because(why: Ended) -> Result<NodeError, RouteError> {
    match why {
        Ended::Right(error) => Ok(error.into()),
        Ended::Closed => Err(RouteError::NodeClosed),
    }
}

/// Returns the ticks of a route's periodic work.
pub fn ticks() -> Ticks {
    Ticks::new(LOOK)
}
