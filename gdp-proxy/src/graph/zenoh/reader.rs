//! A reader of a topic, which subscribes as publishers appear.

use std::collections::{BTreeMap, HashSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use gdp_ros_zenoh::{
    Gid, Inbox, NotCarried, Qos as TokenQos, RawSubscriber, Received, Role, Snapshot, Topic, TypeHash,
};
use tokio::sync::watch;
use tokio::time::Instant;

use super::ZenohGraph;
use super::publishers::Publishers;
use super::view;
use crate::graph::event::{Arrived, Event, GraphError};
use crate::ros2::{Qos, TopicName, TypeName};
use gdp_ros::roster::Offer;

/// Bound on the types of one topic that are read.
const MAX_TYPES: usize = 8;

/// Time for which a message waits for the token of its publisher.
const EARLY: Duration = Duration::from_secs(1);

/// Bound on the messages that wait for tokens.
const MAX_EARLY: usize = 64;
/// Bound on their bytes.
const MAX_EARLY_BYTES: usize = 32 << 20;

/// A reader of a topic. Each type of the topic has a subscriber, because a key names the type.
pub struct ZenohReader<'a> {
    zenoh: &'a ZenohGraph,
    topic: TopicName,
    kind: Option<TypeName>,
    qos: Option<Qos>,
    graph: watch::Receiver<Arc<Snapshot>>,
    publishers: Publishers,
    proxies: Proxies,
    subscribers: BTreeMap<(String, TypeHash), Half>,
    inbox: Inbox,
    events: VecDeque<Event>,
    early: VecDeque<(Instant, Received)>,
}

/// What identifies messages of proxies, which come from the fabric.
#[derive(Default)]
struct Proxies {
    sessions: HashSet<String>,
    publishers: HashSet<Gid>,
}

struct Half {
    _subscriber: RawSubscriber,
    /// The transient-local depth that was requested, or 0.
    latched: u32,
}

impl<'a> ZenohReader<'a> {
    pub fn new(zenoh: &'a ZenohGraph, topic: &TopicName, kind: Option<&TypeName>, qos: Option<Qos>) -> Self {
        let mut graph = zenoh.node.graph();
        graph.mark_changed();
        Self {
            zenoh,
            topic: topic.clone(),
            kind: kind.cloned(),
            qos,
            graph,
            publishers: Publishers::default(),
            proxies: Proxies::default(),
            subscribers: BTreeMap::new(),
            inbox: Inbox::default(),
            events: VecDeque::new(),
            early: VecDeque::new(),
        }
    }

    /// Waits for the next event. Safe to cancel.
    pub async fn next(&mut self) -> Result<Event, GraphError> {
        loop {
            if let Some(event) = self.events.pop_front() {
                return Ok(event);
            }
            let due = self.early.front().map(|(due, _)| *due);
            tokio::select! {
                biased;
                changed = self.graph.changed() => {
                    changed.map_err(|_| GraphError::Left)?;
                    self.look()?;
                }
                () = until(due) => {
                    if let Some((_, received)) = self.early.pop_front() {
                        self.take_unnamed(received);
                    }
                }
                message = self.inbox.recv() => self.take(message),
            }
        }
    }

    /// Reads the transient-local history once more.
    pub fn again(&mut self) -> Result<(), GraphError> {
        self.subscribers.retain(|_, half| half.latched == 0);
        self.subscribe()
    }

    fn take(&mut self, message: Result<Received, NotCarried>) {
        let received = match message {
            Ok(received) => received,
            Err(NotCarried { error, attachment }) => {
                attachment.iter().for_each(|attachment| self.publishers.skip(attachment));
                return self.events.push_back(Event::Unreadable(error.to_string()));
            }
        };
        if self.is_of_proxy(&received) {
            return;
        }
        match self.publishers.of(&received) {
            Some(key) => self.carry(Some(key), received),
            None => self.wait_for_token(Instant::now() + EARLY, received),
        }
    }

    /// Queues a message until the token of its publisher is there.
    fn wait_for_token(&mut self, due: Instant, received: Received) {
        self.early.push_back((due, received));
        let bytes = |early: &VecDeque<(Instant, Received)>| early.iter().map(|(_, it)| it.bytes.len()).sum::<usize>();
        while self.early.len() > MAX_EARLY || bytes(&self.early) > MAX_EARLY_BYTES {
            let Some((_, oldest)) = self.early.pop_front() else { break };
            self.take_unnamed(oldest);
        }
    }

    /// Takes a message whose publisher did not appear.
    fn take_unnamed(&mut self, received: Received) {
        if !self.is_of_proxy(&received) {
            let key = self.publishers.of(&received).or_else(|| self.publishers.only());
            self.carry(key, received);
        }
    }

    fn carry(&mut self, from: Option<u128>, received: Received) {
        let Received { attachment, bytes, .. } = received;
        let lost = from.map_or(0, |key| self.publishers.lost(key, attachment.sequence));
        // Those that the inbox lost are in the numbers as well, if there are numbers.
        let unread = self.inbox.take_lost();
        let lost = if from.is_some() { lost } else { unread };
        let written_ns = u64::try_from(attachment.time_ns).ok();
        self.events.push_back(Event::Message(Arrived { from, bytes, written_ns, lost }));
    }

    /// Whether a proxy has published a message.
    fn is_of_proxy(&self, received: &Received) -> bool {
        let Proxies { sessions, publishers } = &self.proxies;
        let session = received.session.as_deref();
        session.is_some_and(|session| sessions.contains(session)) || publishers.contains(&received.attachment.gid)
    }

    /// Compares the publishers of the graph with the known ones.
    fn look(&mut self) -> Result<(), GraphError> {
        // The queued messages come from the publishers that were there.
        while let Some(message) = self.inbox.try_recv() {
            self.take(message);
        }
        let snapshot = self.graph.borrow_and_update().clone();
        self.proxies = Proxies::new(&snapshot);
        let found: BTreeMap<_, _> = view::publishers(&snapshot, &self.topic).into_iter().collect();
        let gone: Vec<_> = self.publishers.by_key.keys().filter(|key| !found.contains_key(key)).copied().collect();
        for key in gone {
            self.publishers.remove(&key);
            self.events.push_back(Event::Left(key));
        }
        for (key, seen) in found {
            if self.publishers.by_key.get(&key) != Some(&seen) {
                let (kind, node, offers) = (seen.kind.clone(), seen.node.clone(), seen.offers);
                self.events.push_back(Event::Joined { key, kind, node, offers });
                self.publishers.by_key.insert(key, seen);
            }
        }
        for (due, received) in std::mem::take(&mut self.early) {
            if self.is_of_proxy(&received) {
                continue;
            }
            match self.publishers.of(&received) {
                Some(key) => self.carry(Some(key), received),
                None => self.wait_for_token(due, received),
            }
        }
        self.subscribe()
    }

    /// Subscribes to the types that the known publishers have.
    fn subscribe(&mut self) -> Result<(), GraphError> {
        let mut wanted: BTreeMap<(String, TypeHash), Offer> = BTreeMap::new();
        for seen in self.publishers.by_key.values() {
            let Some(hash) = seen.endpoint.hash else { continue };
            if self.kind.as_ref().is_some_and(|kind| kind.as_str() != seen.kind.name) {
                continue;
            }
            let offers = wanted.entry((seen.endpoint.kind.clone(), hash)).or_insert(seen.offers);
            offers.reliable &= seen.offers.reliable;
            if seen.offers.transient_local {
                let depth = if offers.transient_local { offers.depth } else { 1 };
                // 0 keeps all.
                let deepest = if depth.min(seen.offers.depth) == 0 { 0 } else { depth.max(seen.offers.depth) };
                (offers.transient_local, offers.depth) = (true, deepest);
            }
        }
        self.subscribers.retain(|of, _| wanted.contains_key(of));
        for ((kind, hash), offers) in wanted.into_iter().take(MAX_TYPES) {
            let offers = self.qos.map_or(offers, Offer::from);
            let latched = match (offers.transient_local, offers.depth) {
                (false, _) => 0,
                (true, 0) => u32::MAX,
                (true, depth) => depth,
            };
            let of = (kind.clone(), hash);
            if self.subscribers.get(&of).is_some_and(|half| half.latched >= latched) {
                continue;
            }
            let qos: TokenQos = view::qos(&Offer { deadline_ns: 0, lifespan_ns: 0, liveliness_ns: 0, ..offers });
            let topic = Topic { name: self.topic.as_str().into(), kind, hash, qos };
            let subscriber = RawSubscriber::new(&self.zenoh.node, &topic, &self.inbox)?;
            self.subscribers.insert(of, Half { _subscriber: subscriber, latched });
        }
        Ok(())
    }
}

impl Proxies {
    fn new(snapshot: &Snapshot) -> Self {
        let sessions = view::proxies(snapshot);
        let publishers = snapshot.entities.iter().filter(|entity| entity.token.role == Role::Publisher);
        let publishers = publishers.filter(|entity| sessions.contains(entity.token.session.as_str()));
        let publishers = publishers.map(|entity| entity.gid).collect();
        Self { sessions: sessions.into_iter().map(str::to_owned).collect(), publishers }
    }
}

async fn until(due: Option<Instant>) {
    match due {
        Some(due) => tokio::time::sleep_until(due).await,
        None => std::future::pending().await,
    }
}
