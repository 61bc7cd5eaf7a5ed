//! A topic in a DDS domain.

use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use tokio::sync::watch;

use super::{Event, Key, WriteError};
use crate::roster::{Kind, Offer};
use crate::ros2::{
    self, Domain, Publisher, Publishers, Qos, RawReader, RawSample, RawWriter, RosError, TopicName, TypeName,
};

/// Reads a topic, of which it makes its readers as publishers appear. Those that latch have one of their own: it asks for what they keep,
/// and others would not match that.
pub struct Reader<'a> {
    domain: &'a Domain,
    topic: TopicName,
    dds_topic: String,
    /// Of the configuration, or of the first publisher.
    kind: Option<TypeName>,
    qos: Option<Qos>,
    publishers: watch::Receiver<Publishers>,
    known: BTreeMap<Key, Publisher>,
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
        let mut publishers = domain.publishers();
        publishers.mark_changed();
        Self {
            domain,
            topic: topic.clone(),
            dds_topic: topic.to_dds(),
            kind: kind.cloned(),
            qos,
            publishers,
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
            let Self { publishers, live, latched, .. } = self;
            let (is_latched, arrived) = tokio::select! {
                biased;
                changed = publishers.changed() => {
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
                    let latches = self.known.get(&key).is_some_and(|publisher| publisher.offers.transient_local);
                    if self.qos.is_none() && latches != is_latched {
                        continue;
                    }
                    Event::Message(super::Arrived { from, bytes: arrived.sample.bytes, written_ns: arrived.written_ns })
                }
                Err(error) => Event::Unreadable(error.to_string()),
            };
            self.events.push_back(event);
        }
    }

    /// Compares what is discovered with what is known.
    fn look(&mut self) -> Result<(), RosError> {
        let publishers = self.publishers.borrow_and_update().clone();
        let found = publishers.get(&self.dds_topic).map_or(&[][..], Vec::as_slice);
        let gone: Vec<Key> =
            self.known.keys().filter(|key| !found.iter().any(|publisher| publisher.key == **key)).copied().collect();
        for key in gone {
            self.known.remove(&key);
            self.events.push_back(Event::Left(key));
        }
        for publisher in found {
            if self.known.get(&publisher.key) != Some(publisher) {
                let Publisher { key, kind, offers } = publisher.clone();
                self.known.insert(key, publisher.clone());
                self.events.push_back(Event::Joined { key, kind, offers });
            }
        }
        self.ask()
    }

    /// Makes the readers that the known publishers need.
    fn ask(&mut self) -> Result<(), RosError> {
        if self.kind.is_none()
            && let Some(publisher) = self.known.values().next()
        {
            self.kind = Some(TypeName::parse(&publisher.kind.name)?);
        }
        let Some(kind) = &self.kind else { return Ok(()) };
        let name = kind.to_string();
        let of = |latches: bool| {
            let offers = self.known.values().filter(|publisher| publisher.kind.name == name).map(|it| it.offers);
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
