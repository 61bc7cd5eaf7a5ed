//! Collects snapshots while somebody looks at the page: at most one a second, however many look.
//! Names and members change slowly and cost more, so they are asked for every 5 seconds.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use gdp_proto::admin::Request;
use gdp_proto::admin::links::PeersReply;
use gdp_proto::admin::status::StatusReply;
use gdp_proto::admin::tables::{FibReply, RibReply};
use gdp_proto::admin::topology::TopologyReply;
use gdp_util::unix_time::unix_seconds;
use parking_lot::Mutex;

use super::events::RecentEvents;
use super::problems;
use super::snapshot::{Bounded, Labels, PageSnapshot, Problem, Severity, text};
use super::view::{self, MAX_ROWS, NamesInUse};
use crate::cli::context::Context;
use crate::cli::home::{HomeOptions, RobotsOutput, robots_of};
use crate::client::Client;
use gdp::Keyring;
use gdp::unstable::called;

/// Age up to which a snapshot serves further requests.
const FRESH: Duration = Duration::from_millis(900);

/// Age up to which names, labels and members are not asked for again.
const SLOW: Duration = Duration::from_secs(5);

/// Kinds of cards that name something of ROS.
const KINDS: [&str; 4] = ["topic", "service", "action", "catalog"];

pub struct Collector {
    context: Context,
    home: HomeOptions,
    keyring: Option<PathBuf>,
    events: Arc<RecentEvents>,
    latest: Mutex<Latest>,
    begun: Instant,
    members: Arc<Members>,
}

#[derive(Default)]
struct Latest {
    /// JSON text.
    snapshot: Option<(Instant, Arc<str>)>,
    names: Option<(Instant, NamesInUse)>,
    labels: Option<(Instant, Labels)>,
}

/// The members, which a thread of their own reads: another command may have locked their files.
#[derive(Default)]
struct Members {
    is_reading: AtomicBool,
    known: Mutex<Option<(Instant, Found)>>,
}

/// The members, if this machine has the domain's files, or why they cannot be read.
type Found = Result<Option<RobotsOutput>, String>;

impl Collector {
    pub fn new(context: Context, home: HomeOptions, keyring: Option<PathBuf>, events: Arc<RecentEvents>) -> Self {
        Self {
            context,
            home,
            keyring,
            events,
            latest: Mutex::default(),
            begun: Instant::now(),
            members: Arc::default(),
        }
    }

    /// Returns a snapshot that is at most a second old, as JSON. Blocks.
    pub fn snapshot(&self) -> Arc<str> {
        let mut latest = self.latest.lock();
        if let Some((at, snapshot)) = &latest.snapshot
            && at.elapsed() < FRESH
        {
            return snapshot.clone();
        }
        let snapshot = self.collect(&mut latest);
        // Numbers and texts are always JSON.
        let json: Arc<str> = serde_json::to_string(&snapshot).unwrap_or_default().into();
        latest.snapshot = Some((Instant::now(), json.clone()));
        json
    }

    fn collect(&self, latest: &mut Latest) -> PageSnapshot {
        self.read_members();
        self.read_labels(latest);
        let mut snapshot = PageSnapshot {
            at_ms: unix_millis(),
            uptime_ms: self.begun.elapsed().as_millis() as u64,
            events: self.events.latest(),
            ..PageSnapshot::default()
        };
        let mut found = Vec::new();
        let labels = latest.labels.as_ref().map(|(_, labels)| labels.clone()).unwrap_or_default();
        if let Err(error) = self.ask(&mut snapshot, &mut found, &mut latest.names, &labels) {
            snapshot.no_daemon = Some(text(&error.to_string()));
            found.push(Problem { severity: Severity::Down, what: text(&error.to_string()) });
        }
        match &*self.members.known.lock() {
            None => snapshot.robots_error = Some("Reading the domain's files…".into()),
            Some((_, Ok(None))) => {}
            Some((_, Ok(Some(robots)))) => {
                snapshot.robots = Some(view::robots(robots, &labels));
                found.extend(problems::of_members(robots));
            }
            Some((_, Err(error))) => snapshot.robots_error = Some(text(error)),
        }
        found.sort_by_key(|problem| problem.severity);
        snapshot.problems = Bounded::new(found, MAX_ROWS);
        snapshot
    }

    fn ask(
        &self,
        snapshot: &mut PageSnapshot,
        found: &mut Vec<Problem>,
        names: &mut Option<(Instant, NamesInUse)>,
        labels: &Labels,
    ) -> anyhow::Result<()> {
        let mut client = self.context.client()?;
        let status: Box<StatusReply> = client.ask(&Request::Status)?;
        let topology: TopologyReply = client.ask(&Request::Topology)?;
        let peers: PeersReply = client.ask(&Request::Peers)?;
        if is_old(names) {
            let read = match status.rib {
                Some(_) => {
                    client.ask::<RibReply>(&Request::Rib { after: None }).map(|reply| NamesInUse::of_rib(&reply))
                }
                None => client.ask::<FibReply>(&Request::Fib { after: None }).map(|reply| NamesInUse::of_fib(&reply)),
            };
            *names = Some((Instant::now(), read?));
        }
        found.extend(problems::find(&status, &topology, &peers, labels, unix_seconds()));
        if let Some((_, names)) = names {
            view::fill(snapshot, &status, &topology, &peers, names, labels);
        }
        Ok(())
    }

    /// Reads what people call names: cards of the keyring, and labels of members.
    fn read_labels(&self, latest: &mut Latest) {
        if !is_old(&latest.labels) {
            return;
        }
        let mut labels = Labels::default();
        // Without a keyring, names stay numbers.
        if let Some(keyring) = self.keyring.as_deref().and_then(|folder| Keyring::open(folder).ok()) {
            let cards = KINDS.iter().flat_map(|kind| keyring.cards(kind));
            labels.0.extend(cards.map(|card| (card.name(), called(card).to_owned())));
        }
        if let Some((_, Ok(Some(robots)))) = &*self.members.known.lock() {
            let members = robots.members.iter().filter(|member| member.fingerprint.is_none());
            labels.0.extend(members.filter_map(|member| Some((member.entity?, member.label.clone()))));
        }
        latest.labels = Some((Instant::now(), labels));
    }

    /// Starts to read the members again, if what is known of them is old.
    fn read_members(&self) {
        if !is_old(&self.members.known.lock()) || self.members.is_reading.swap(true, Ordering::AcqRel) {
            return;
        }
        let (members, home, context) = (self.members.clone(), self.home.clone(), self.context.clone());
        std::thread::spawn(move || {
            let read = robots_of(&home, &context).map_err(|error| format!("{error:#}"));
            *members.known.lock() = Some((Instant::now(), read));
            members.is_reading.store(false, Ordering::Release);
        });
    }

    /// Returns a connection to the daemon for one more question.
    pub fn client(&self) -> anyhow::Result<Client> {
        self.context.client()
    }

    /// Returns the labels of the latest snapshot.
    pub fn labels(&self) -> Labels {
        self.latest.lock().labels.as_ref().map(|(_, labels)| labels.clone()).unwrap_or_default()
    }
}

fn is_old<T>(known: &Option<(Instant, T)>) -> bool {
    known.as_ref().is_none_or(|(at, _)| at.elapsed() >= SLOW)
}

fn unix_millis() -> u64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    now.map_or(0, |since| since.as_millis() as u64)
}
