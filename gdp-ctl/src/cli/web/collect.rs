//! Collects snapshots while somebody looks at the page: at most one a second, however many look.
//! Names and members change slowly and cost more, so they are asked for every 5 seconds.
//!
//! One thread collects. A request waits a little for it, then gets the last snapshot with its age,
//! so a daemon that does not answer delays nobody.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use gdp_proto::admin::Request;
use gdp_proto::admin::links::PeersReply;
use gdp_proto::admin::status::StatusReply;
use gdp_proto::admin::tables::{FibReply, RibReply};
use gdp_proto::admin::topology::TopologyReply;
use gdp_util::unix_time::{unix_nanos, unix_seconds};
use parking_lot::{Condvar, Mutex};
use serde::Serialize;

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

/// Time that a request waits for a snapshot that is being collected.
const LONGEST_WAIT: Duration = Duration::from_secs(2);

/// Age up to which names, labels and members are not asked for again.
const SLOW: Duration = Duration::from_secs(5);

/// Kinds of cards that name something of ROS.
const KINDS: [&str; 4] = ["topic", "service", "action", "catalog"];

pub struct Collector {
    context: Context,
    home: HomeOptions,
    keyring: Option<PathBuf>,
    events: Arc<RecentEvents>,
    collected: Mutex<Collected>,
    /// A snapshot has been collected.
    renewed: Condvar,
    /// Only the thread that collects keeps this locked.
    slow: Mutex<Slow>,
    labels: Mutex<Labels>,
    begun: Instant,
    members: Arc<Members>,
}

#[derive(Default)]
struct Collected {
    latest: Option<(Instant, Arc<PageSnapshot>)>,
    /// The thread that collects, and when it began.
    collecting: Option<(Instant, JoinHandle<()>)>,
}

impl Collected {
    fn is_fresh(&self) -> bool {
        self.latest.as_ref().is_some_and(|(at, _)| at.elapsed() < FRESH)
    }
}

/// What is not asked for each time.
#[derive(Default)]
struct Slow {
    names: Option<(Instant, NamesInUse)>,
    labels_read: Option<Instant>,
}

/// A snapshot, and how long it has been there.
#[derive(Serialize)]
struct AgedSnapshot<'a> {
    age_ms: u64,
    #[serde(flatten)]
    snapshot: &'a PageSnapshot,
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
            collected: Mutex::default(),
            renewed: Condvar::new(),
            slow: Mutex::default(),
            labels: Mutex::default(),
            begun: Instant::now(),
            members: Arc::default(),
        }
    }

    /// Returns the latest snapshot as JSON, at most a second old if the daemon answers within
    /// [`LONGEST_WAIT`]. Blocks that long.
    ///
    /// # Errors
    ///
    /// Fails if there is no snapshot yet.
    pub fn snapshot(self: &Arc<Self>) -> anyhow::Result<String> {
        let mut collected = self.collected.lock();
        let since = match &collected.collecting {
            Some((since, thread)) if !thread.is_finished() => *since,
            _ if collected.is_fresh() => Instant::now(),
            _ => {
                let (now, collector) = (Instant::now(), self.clone());
                let thread = std::thread::Builder::new().name("collector".into()).spawn(move || collector.collect());
                collected.collecting = Some((now, thread.context("cannot start a thread")?));
                now
            }
        };
        let until = Instant::now() + LONGEST_WAIT;
        self.renewed.wait_while_until(&mut collected, |collected| !collected.is_fresh(), until);
        let Some((at, snapshot)) = collected.latest.clone() else {
            bail!("the daemon has not answered for {} s", since.elapsed().as_secs());
        };
        drop(collected);
        let age_ms = at.elapsed().as_millis() as u64;
        Ok(serde_json::to_string(&AgedSnapshot { age_ms, snapshot: &snapshot })?)
    }

    fn collect(&self) {
        let snapshot = Arc::new(self.collect_from(&mut self.slow.lock()));
        self.collected.lock().latest = Some((Instant::now(), snapshot));
        self.renewed.notify_all();
    }

    fn collect_from(&self, slow: &mut Slow) -> PageSnapshot {
        self.read_members();
        self.read_labels(slow);
        let mut snapshot = PageSnapshot {
            at_ms: unix_nanos() / 1_000_000,
            uptime_ms: self.begun.elapsed().as_millis() as u64,
            events: self.events.latest(),
            ..PageSnapshot::default()
        };
        let mut found = Vec::new();
        let labels = self.labels();
        if let Err(error) = self.ask(&mut snapshot, &mut found, &mut slow.names, &labels) {
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
    fn read_labels(&self, slow: &mut Slow) {
        if slow.labels_read.is_some_and(|at| at.elapsed() < SLOW) {
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
        *self.labels.lock() = labels;
        slow.labels_read = Some(Instant::now());
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
        self.labels.lock().clone()
    }
}

fn is_old<T>(known: &Option<(Instant, T)>) -> bool {
    known.as_ref().is_none_or(|(at, _)| at.elapsed() >= SLOW)
}
