//! A topic in a DDS domain.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use tokio::sync::watch;

use super::{Event, Key, WriteError};
use crate::ros2::{
    self, Domain, Durability, Endpoint, Graph, Qos, RawReader, RawSample, RawWriter, Reliability, RosError, ShownQos,
    TopicName, TypeName,
};
use crate::roster::{Dialect, Kind, Offer};

/// Reads a topic, of which it makes its readers as publishers appear. Those that latch have one of their own: it asks for what they keep,
/// and others would not match that.
pub struct Reader<'a> {
    domain: &'a Domain,
    topic: TopicName,
    /// Of the configuration, or of the first publisher.
    kind: Option<TypeName>,
    qos: Option<Qos>,
    graph: watch::Receiver<Arc<Graph>>,
    known: BTreeMap<Key, (Kind, Offer)>,
    live: Option<Half>,
    latched: Option<Half>,
    events: VecDeque<Event>,
}

struct Half {
    reader: RawReader,
    asks: Offer,
}

/// Stands for a publisher elsewhere.
pub struct Writer(RawWriter);

impl<'a> Reader<'a> {
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
            live: None,
            latched: None,
            events: VecDeque::new(),
        }
    }

    /// Safe to cancel.
    pub async fn next(&mut self) -> Result<Event, RosError> {
        loop {
            if let Some(event) = self.events.pop_front() {
                return Ok(event);
            }
            let Self { graph, live, latched, .. } = self;
            let (is_latched, arrived) = tokio::select! {
                biased;
                changed = graph.changed() => {
                    if changed.is_err() {
                        // Nobody discovers any more: the domain is being left.
                        std::future::pending::<()>().await;
                    }
                    self.look()?;
                    continue;
                }
                arrived = recv(latched) => (true, arrived),
                arrived = recv(live) => (false, arrived),
            };
            let event = match arrived {
                Ok(arrived) => {
                    let key = Key::from_be_bytes(arrived.writer.to_bytes());
                    let from = self.known.contains_key(&key).then_some(key);
                    // The other reader has it, too.
                    let latches = self.known.get(&key).is_some_and(|(_, offers)| offers.transient_local);
                    if self.qos.is_none() && latches != is_latched {
                        continue;
                    }
                    let ros2::Arrived { sample, written_ns, lost, .. } = arrived;
                    Event::Message(super::Arrived { from, bytes: sample.bytes, written_ns, lost })
                }
                Err(error) => Event::Unreadable(error.to_string()),
            };
            self.events.push_back(event);
        }
    }

    /// Compares what is discovered with what is known.
    fn look(&mut self) -> Result<(), RosError> {
        let graph = self.graph.borrow_and_update().clone();
        let found = graph.topics.get(&self.topic).map_or(&[][..], |topic| &topic.publishers);
        let found: BTreeMap<Key, (Kind, Offer)> =
            found.iter().map(|publisher| (Key::from_be_bytes(publisher.id), described(publisher))).collect();
        let gone = self.known.keys().filter(|key| !found.contains_key(key)).map(|key| Event::Left(*key));
        self.events.extend(gone);
        for (key, (kind, offers)) in &found {
            if self.known.get(key).is_none_or(|(kind_before, before)| (kind_before, before) != (kind, offers)) {
                self.events.push_back(Event::Joined { key: *key, kind: kind.clone(), offers: *offers });
            }
        }
        self.known = found;
        self.ask()
    }

    /// Makes the readers that the known publishers need.
    fn ask(&mut self) -> Result<(), RosError> {
        if self.kind.is_none()
            && let Some((kind, _)) = self.known.values().next()
        {
            self.kind = Some(TypeName::parse(&kind.name)?);
        }
        let Some(kind) = &self.kind else { return Ok(()) };
        let name = kind.to_string();
        let of = |latches: bool| {
            let offers = self.known.values().filter(|(kind, _)| kind.name == name).map(|(_, offers)| *offers);
            let offers: Vec<Offer> = offers.filter(|offers| offers.transient_local == latches).collect();
            // A reader that asks for more than somebody offers does not hear it.
            let reliable = offers.iter().all(|offers| offers.reliable);
            let depth = offers.iter().map(|offers| offers.depth).max()?;
            Some(Offer { reliable, transient_local: latches, depth, deadline_ns: 0, lifespan_ns: 0 })
        };
        let (live, latched) = match self.qos {
            Some(qos) => (Some(Offer::from(qos)), None),
            None => (of(false), of(true)),
        };
        for (half, asks) in [(&mut self.live, live), (&mut self.latched, latched)] {
            if let Some(asks) = asks.filter(|asks| half.as_ref().is_none_or(|half| half.asks != *asks)) {
                *half = Some(Half { reader: self.domain.reader(&self.topic, kind, &asks)?, asks });
            }
        }
        Ok(())
    }
}

/// What discovery says of a publisher. It does not say how many messages it keeps: 10 as ROS 2 has it by default, or of what is latched the
/// last one.
fn described(publisher: &Endpoint) -> (Kind, Offer) {
    let Endpoint { kind, hash, qos, .. } = publisher;
    let ShownQos { reliability, durability, deadline, lifespan, .. } = *qos;
    let hash = hash.as_ref().and_then(|hash| hex::decode(hash.as_str().strip_prefix("RIHS01_")?).ok());
    let ns = |time: Option<Duration>| time.map_or(0, |time| u64::try_from(time.as_nanos()).unwrap_or(0));
    let transient_local = durability == Durability::TransientLocal;
    let offers = Offer {
        reliable: reliability == Reliability::Reliable,
        transient_local,
        depth: if transient_local { 1 } else { 10 },
        deadline_ns: ns(deadline),
        lifespan_ns: ns(lifespan),
    };
    (Kind { dialect: Dialect::Ros2, name: kind.to_string(), hash: hash.unwrap_or_default() }, offers)
}

async fn recv(half: &Option<Half>) -> Result<ros2::Arrived, ros2::Unreadable> {
    match half {
        Some(half) => half.reader.recv().await,
        None => std::future::pending().await,
    }
}

impl Writer {
    pub fn new(domain: &Domain, topic: &TopicName, kind: &Kind, offers: Offer) -> Result<Self, RosError> {
        domain.writer(topic, &TypeName::parse(&kind.name)?, &offers).map(Self)
    }

    pub async fn write(&mut self, bytes: Bytes, timestamp_ns: u64) -> Result<(), WriteError> {
        let sample = RawSample::parse(bytes).ok_or(WriteError::Malformed)?;
        self.0.write(sample, timestamp_ns).await.map_err(|error| match error {
            ros2::WriteError::Stalled => WriteError::Stalled,
            ros2::WriteError::Failed(why) => WriteError::Failed(why),
        })
    }
}
