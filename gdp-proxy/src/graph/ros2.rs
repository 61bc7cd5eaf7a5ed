//! A topic in a DDS domain.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use tokio::sync::watch;
use tokio::time::Instant;

use crate::graph::event::{ArrivalSink, Event, Incompatibility, Key, WriteError};
use crate::ros2::{
    self, Depth, DisplayedQos, Domain, Durability, Endpoint, Graph, Qos, RawReader, RawSample, RawWriter, Reliability,
    RosError, TopicName, TypeName, WriterChange,
};
use gdp_ros::roster::{Dialect, Kind, Offer};

/// A reader of a topic, which creates its DDS readers as publishers appear. Transient-local
/// publishers have a reader of their own. It requests their history, and would not match volatile
/// publishers.
pub struct Ros2Reader<'a> {
    domain: &'a Domain,
    topic: TopicName,
    /// The type, from the configuration or of the first publisher.
    kind: Option<TypeName>,
    qos: Option<Qos>,
    graph: watch::Receiver<Arc<Graph>>,
    known: BTreeMap<Key, Known>,
    /// Number of messages that transient-local publishers keep. They may not be discovered yet.
    histories: BTreeMap<Key, u32>,
    live: Option<Half>,
    latched: Option<Half>,
    events: VecDeque<Event>,
    /// Messages of publishers that are not discovered yet. Each has the end of its wait, and
    /// whether the transient-local reader received it.
    early: VecDeque<(Instant, bool, ros2::Arrived)>,
}

struct Known {
    kind: Kind,
    node: Arc<str>,
    offers: Offer,
    /// The time at which the departure of the publisher is reported, after it has left. Its last
    /// messages may arrive later than the news from discovery.
    left_at: Option<Instant>,
    /// Whether the lease of its liveliness is in force.
    alive: bool,
}

struct Half {
    reader: RawReader,
    asks: Offer,
}

/// Time for which a message waits for the discovery of its publisher.
const EARLY: Duration = Duration::from_secs(3);
/// Bound on the messages that wait for discovery.
const MAX_EARLY: usize = 256;
/// Bound on their bytes.
const MAX_EARLY_BYTES: usize = 32 << 20;

/// Number of recorded histories at which those of unknown publishers are forgotten.
const MAX_HISTORIES: usize = 1024;

/// The vendor ID of RustDDS, with which GUIDs begin (RTPS 2.5 §9.3.1.5).
const RUSTDDS: [u8; 2] = [0x01, 0x12];

/// A depth that has grown by less than this part is not announced again.
const SLACK: u32 = 8;

/// Greatest depth that a publisher is taken to have.
const MAX_DEPTH: u32 = Depth::MAX as u32;

/// Time to wait for the last messages of a publisher that has left.
const LATE: Duration = Duration::from_millis(200);

/// A writer on behalf of a remote publisher.
pub struct Ros2Writer(RawWriter);

/// Writes messages of a [`Ros2Writer`] from any thread, at once or not at all.
pub struct ImmediateWriter(ros2::ImmediateWriter);

impl ImmediateWriter {
    /// Returns false if the message was not taken.
    pub fn write(&self, bytes: Bytes, timestamp_ns: u64) -> bool {
        RawSample::parse(bytes).is_some_and(|sample| self.0.write(&sample, timestamp_ns))
    }
}

impl<'a> Ros2Reader<'a> {
    pub fn new(domain: &'a Domain, topic: &TopicName, kind: Option<&TypeName>, qos: Option<Qos>) -> Self {
        let mut graph = domain.graph();
        graph.mark_changed();
        Self {
            domain,
            topic: topic.clone(),
            kind: kind.cloned(),
            qos,
            graph,
            known: BTreeMap::new(),
            histories: BTreeMap::new(),
            live: None,
            latched: None,
            events: VecDeque::new(),
            early: VecDeque::new(),
        }
    }

    /// Waits for the next event. Safe to cancel.
    pub async fn next(&mut self) -> Result<Event, RosError> {
        loop {
            if let Some(event) = self.events.pop_front() {
                // The route processes the event before messages that come later.
                self.halves().for_each(|(_, half)| half.reader.suspend_sink());
                return Ok(event);
            }
            let Self { graph, live, latched, early, known, .. } = self;
            let left_at = known.values().filter_map(|known| known.left_at).min();
            let (is_latched, arrived) = tokio::select! {
                biased;
                changed = graph.changed() => {
                    if changed.is_err() {
                        // Discovery has ended, because the proxy leaves the domain.
                        std::future::pending::<()>().await;
                    }
                    self.look()?;
                    continue;
                }
                () = sleep_until(early.front().map(|(over, ..)| *over)) => {
                    self.drop_early();
                    continue;
                }
                () = sleep_until(left_at) => {
                    self.report_left();
                    continue;
                }
                change = writer_change(latched) => {
                    self.report_change(change);
                    continue;
                }
                change = writer_change(live) => {
                    self.report_change(change);
                    continue;
                }
                arrived = recv(latched) => (true, arrived),
                arrived = recv(live) => (false, arrived),
            };
            match arrived {
                Ok(arrived) => self.take(is_latched, arrived),
                Err(error) => self.events.push_back(Event::Unreadable(error.to_string())),
            }
        }
    }

    fn report_change(&mut self, change: WriterChange) {
        match change {
            WriterChange::Liveliness(writer, alive) => self.report_liveliness(writer, alive),
            WriterChange::History(writer, samples) => self.report_history(Key::from_be_bytes(writer), samples),
        }
    }

    /// Takes what a writer keeps for late joiners as its depth. It may not be discovered yet.
    /// Writers of RustDDS keep more for repairs.
    fn report_history(&mut self, key: Key, samples: usize) {
        if key.to_be_bytes().starts_with(&RUSTDDS) {
            return;
        }
        let samples = u32::try_from(samples).map_or(MAX_DEPTH, |samples| samples.clamp(1, MAX_DEPTH));
        if self.histories.len() >= MAX_HISTORIES {
            self.histories.retain(|key, _| self.known.contains_key(key));
        }
        self.histories.insert(key, samples);
        let is_by_publisher = self.qos.is_none();
        let known = self.known.get_mut(&key).filter(|known| is_by_publisher && known.offers.transient_local);
        // A publisher whose messages expire keeps more at times.
        let is_deeper = |known: &Known| samples > known.offers.depth + known.offers.depth / SLACK;
        if let Some(known) = known.filter(|known| is_deeper(known)) {
            known.offers.depth = samples;
            let (kind, node, offers) = (known.kind.clone(), known.node.clone(), known.offers);
            self.events.push_back(Event::Joined { key, kind, node, offers });
            if !known.alive {
                self.events.push_back(Event::Liveliness { key, alive: false });
            }
        }
    }

    fn report_liveliness(&mut self, writer: [u8; 16], alive: bool) {
        let key = Key::from_be_bytes(writer);
        if let Some(known) = self.known.get_mut(&key).filter(|known| known.alive != alive) {
            known.alive = alive;
            self.events.push_back(Event::Liveliness { key, alive });
        }
    }

    fn take(&mut self, is_latched: bool, arrived: ros2::Arrived) {
        let key = Key::from_be_bytes(arrived.writer.to_bytes());
        let Some(Known { offers, .. }) = self.known.get(&key) else {
            // Discovery updates the graph only periodically.
            self.early.push_back((Instant::now() + EARLY, is_latched, arrived));
            while self.early.len() > MAX_EARLY || self.early_bytes() > MAX_EARLY_BYTES {
                self.drop_early();
            }
            return;
        };
        // The other reader receives it too.
        if self.qos.is_none() && offers.transient_local != is_latched {
            return;
        }
        self.events.push_back(Event::Message(message(key, &arrived)));
    }

    fn early_bytes(&self) -> usize {
        self.early.iter().map(|(_, _, arrived)| arrived.sample.bytes.len()).sum()
    }

    /// Drops the first waiting message. Its writer is probably another proxy, whose messages come
    /// from the fabric.
    fn drop_early(&mut self) {
        self.early.pop_front();
    }

    /// Compares the discovered publishers with the known ones.
    fn look(&mut self) -> Result<(), RosError> {
        let graph = self.graph.borrow_and_update().clone();
        let found = graph.topics.get(&self.topic).map_or(&[][..], |topic| &topic.publishers);
        let described = |publisher: &Endpoint| {
            let (key, (kind, mut offers)) = (Key::from_be_bytes(publisher.id), described(publisher));
            if let Some(depth) = self.histories.get(&key).filter(|_| offers.transient_local) {
                offers.depth = *depth;
            }
            (key, (publisher.node.clone(), (kind, offers)))
        };
        let found: BTreeMap<Key, (Arc<str>, (Kind, Offer))> = found.iter().map(described).collect();
        let told = Instant::now() + LATE;
        for (key, known) in &mut self.known {
            let is_gone = !found.contains_key(key);
            known.left_at = is_gone.then(|| known.left_at.unwrap_or(told));
        }
        for (key, (node, (kind, offers))) in found {
            let same = |before: &Known| (&before.kind, &before.node, before.offers) == (&kind, &node, offers);
            if !self.known.get(&key).is_some_and(same) {
                let asked = self.qos.map(Offer::from);
                let lacking = asked.and_then(|asked| lacking(&offers, &asked)).map(Incompatibility::Qos);
                self.events.push_back(match lacking.or(is_keyed(key).then_some(Incompatibility::Keyed)) {
                    Some(why) => Event::Incompatible { key, why },
                    None => Event::Joined { key, kind: kind.clone(), node: node.clone(), offers },
                });
                let alive = self.known.get(&key).is_none_or(|before| before.alive);
                if !alive {
                    self.events.push_back(Event::Liveliness { key, alive });
                }
                self.known.insert(key, Known { kind, node, offers, left_at: None, alive });
            }
        }
        for (_, is_latched, arrived) in std::mem::take(&mut self.early) {
            self.take(is_latched, arrived);
        }
        self.ask()
    }

    fn report_left(&mut self) {
        let now = Instant::now();
        let left_at = self.known.extract_if(.., |_, known| known.left_at.is_some_and(|told| told <= now));
        for (key, _) in left_at {
            self.histories.remove(&key);
            self.events.push_back(Event::Left(key));
        }
    }

    fn halves(&self) -> impl Iterator<Item = (bool, &Half)> {
        let halves = [(false, &self.live), (true, &self.latched)].into_iter();
        halves.filter_map(|(is_latched, half)| Some((is_latched, half.as_ref()?)))
    }

    /// See [`Reader::set_sink`](super::Reader::set_sink).
    pub fn set_sink(&self, sink: Option<&ArrivalSink>) {
        for (is_latched, half) in self.halves() {
            half.reader.set_sink(sink.map(|sink| self.sink_of(is_latched, sink.clone())));
        }
    }

    /// Returns the sink of one reader. It does for known publishers what [`Self::take`] does.
    fn sink_of(&self, is_latched: bool, sink: ArrivalSink) -> ros2::SampleSink {
        let is_here = |known: &Known| self.qos.is_some() || known.offers.transient_local == is_latched;
        let known: HashMap<Key, bool> = self.known.iter().map(|(key, known)| (*key, is_here(known))).collect();
        Box::new(move |arrived| {
            let key = Key::from_be_bytes(arrived.writer.to_bytes());
            match known.get(&key) {
                Some(true) => sink(&message(key, arrived)),
                // The other reader receives it too.
                Some(false) => true,
                None => false,
            }
        })
    }

    /// Reads the transient-local history once more.
    pub fn again(&mut self) -> Result<(), RosError> {
        self.latched = None;
        self.ask()
    }

    /// Creates the readers that the known publishers need.
    fn ask(&mut self) -> Result<(), RosError> {
        if self.kind.is_none()
            && let Some(Known { kind, .. }) = self.known.values().next()
        {
            self.kind = Some(TypeName::parse(&kind.name)?);
        }
        let Some(kind) = &self.kind else { return Ok(()) };
        let name = kind.to_string();
        let hashes = self.known.values().filter(|known| known.kind.name == name).map(|known| &known.kind.hash);
        let hash = hashes.max_by_key(|hash| hash.len()).cloned().unwrap_or_default();
        let kind = Kind { dialect: Dialect::Ros2, name: name.clone(), hash };
        let of = |latches: bool| {
            let offers = self.known.values().filter(|known| known.kind.name == name).map(|known| known.offers);
            let offers: Vec<Offer> = offers.filter(|offers| offers.transient_local == latches).collect();
            let depth = offers.iter().map(|offers| offers.depth).max()?;
            let half = if latches { &self.latched } else { &self.live };
            let before = half.as_ref().map(|half| half.asks);
            // A reader does not match publishers that offer less than it requests. A best-effort
            // reader stays best-effort, because replacing it would lose the messages that it has
            // received and nobody has read.
            let reliable = offers.iter().all(|offers| offers.reliable) && before.is_none_or(|before| before.reliable);
            let depth = before.map_or(depth, |before| before.depth);
            Some(Offer { reliable, transient_local: latches, depth, ..Qos::default().into() })
        };
        let (live, latched) = match self.qos {
            Some(qos) => (Some(Offer::from(qos)), None),
            None => (of(false), of(true)),
        };
        let mut is_new = false;
        for (half, asks) in [(&mut self.live, live), (&mut self.latched, latched)] {
            if let Some(asks) = asks.filter(|asks| half.as_ref().is_none_or(|half| half.asks != *asks)) {
                *half = Some(Half { reader: self.domain.reader_of(&self.topic, &kind, &asks)?, asks });
                is_new = true;
            }
        }
        if is_new {
            // A new reader takes every writer for alive, and reports the end of each lease again.
            let silent = self.known.iter().filter(|(_, known)| !known.alive).map(|(key, _)| key.to_be_bytes());
            let silent: Vec<_> = silent.collect();
            silent.into_iter().for_each(|writer| self.report_liveliness(writer, true));
        }
        Ok(())
    }
}

fn message(from: Key, arrived: &ros2::Arrived) -> super::Arrived {
    let ros2::Arrived { sample, written_ns, lost, .. } = arrived;
    super::Arrived { from: Some(from), bytes: sample.bytes.clone(), written_ns: *written_ns, lost: *lost }
}

/// Whether a DDS writer has a topic with keys: the last byte of its GUID is its kind (RTPS 2.5
/// §9.3.1.2).
fn is_keyed(writer: Key) -> bool {
    const WRITER_WITH_KEY: u8 = 0x02;
    writer.to_be_bytes()[15] == WRITER_WITH_KEY
}

/// Returns the policy in which a publisher offers less than is requested.
fn lacking(offers: &Offer, asked: &Offer) -> Option<&'static str> {
    // A request without a duration accepts any offer.
    let breaks = |offered: u64, asked: u64| asked > 0 && (offered == 0 || offered > asked);
    let lacking = [
        ("reliability", asked.reliable && !offers.reliable),
        ("durability", asked.transient_local && !offers.transient_local),
        ("deadline", breaks(offers.deadline_ns, asked.deadline_ns)),
        ("liveliness", breaks(offers.liveliness_ns, asked.liveliness_ns)),
        ("liveliness", asked.manual_liveliness && !offers.manual_liveliness),
    ];
    lacking.into_iter().find(|(_, lacks)| *lacks).map(|(policy, _)| policy)
}

pub fn misfit(domain: &Domain, topic: &TopicName, offers: &Offer) -> Option<&'static str> {
    let graph = domain.graph().borrow().clone();
    let subscribers = &graph.topics.get(topic)?.subscribers;
    subscribers.iter().find_map(|subscriber| lacking(offers, &described(subscriber).1))
}

/// Returns the type and the offer of a discovered endpoint. Discovery does not announce its history
/// depth. So the depth is 10, the default of ROS 2. If it is transient local, the depth is 1 until
/// the endpoint tells what it keeps.
fn described(publisher: &Endpoint) -> (Kind, Offer) {
    let Endpoint { kind, hash, qos, .. } = publisher;
    let DisplayedQos { reliability, durability, deadline, lifespan, liveliness_lease, manual_liveliness } = *qos;
    let hash = hash.as_ref().and_then(|hash| hex::decode(hash.as_str().strip_prefix("RIHS01_")?).ok());
    let ns = |time: Option<Duration>| time.map_or(0, |time| u64::try_from(time.as_nanos()).unwrap_or(0));
    let transient_local = durability == Durability::TransientLocal;
    let offers = Offer {
        reliable: reliability == Reliability::Reliable,
        transient_local,
        depth: if transient_local { 1 } else { 10 },
        deadline_ns: ns(deadline),
        lifespan_ns: ns(lifespan),
        liveliness_ns: ns(liveliness_lease),
        manual_liveliness,
    };
    (Kind { dialect: Dialect::Ros2, name: kind.to_string(), hash: hash.unwrap_or_default() }, offers)
}

async fn sleep_until(when: Option<Instant>) {
    match when {
        Some(when) => tokio::time::sleep_until(when).await,
        None => std::future::pending().await,
    }
}

async fn writer_change(half: &Option<Half>) -> WriterChange {
    match half {
        Some(half) => half.reader.writer_change().await,
        None => std::future::pending().await,
    }
}

async fn recv(half: &Option<Half>) -> Result<ros2::Arrived, ros2::Unreadable> {
    match half {
        Some(half) => half.reader.recv().await,
        None => std::future::pending().await,
    }
}

impl Ros2Writer {
    pub fn new(domain: &Domain, topic: &TopicName, kind: &Kind, offers: Offer) -> Result<Self, RosError> {
        domain.writer_of(topic, kind, &offers).map(Self)
    }

    pub fn assign(&mut self, node: &str) {
        self.0.assign(node);
    }

    pub fn immediate_writer(&self) -> ImmediateWriter {
        ImmediateWriter(self.0.immediate_writer())
    }

    pub fn set_depth(&mut self, depth: u32) {
        self.0.set_depth(depth);
    }

    pub fn is_matched(&self) -> bool {
        self.0.has_matched()
    }

    pub async fn write(&mut self, bytes: Bytes, timestamp_ns: u64) -> Result<(), WriteError> {
        let sample = RawSample::parse(bytes).ok_or(WriteError::Malformed)?;
        self.0.write(sample, timestamp_ns).await.map_err(|error| match error {
            ros2::WriteError::Stalled => WriteError::Stalled,
            ros2::WriteError::Failed(why) => WriteError::Failed(why),
        })
    }
}

#[cfg(test)]
#[path = "../../tests/unit/graph/ros2.rs"]
mod tests;
