//! Carries a topic from a ROS graph into the fabric.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::convert::Infallible;
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp::ErrorCode;
use gdp::unstable::{FrameError, NodeError, Publisher};
use gdp_core::cert::{AdCert, Issued};
use gdp_e2e::seal::Draft;
use tokio::runtime::Handle;

use super::format::Outbound;
use super::pace::Pace;
use super::{Published, Route, Way, direct};
use crate::graph::{ArrivalSink, Arrived, Event, GraphError, Key, Reader};
use crate::offload::is_large;
use crate::qos_mapping::publish_options;
use crate::route_status::{RETRY, Right, RouteError, ended_because, ticks};
use crate::stats::{Drop, FabricCounters};
use crate::waiting::Waiting;
use gdp_ros::qos_mapping::{exceeds, latched_depth, merged};
use gdp_ros::roster::{self, Kind, Offer, Outgoing};

/// Reasons for which a route must publish its name anew.
enum Turn {
    /// The certificate is no longer valid.
    Ended(NodeError),
    /// A publisher offers stronger QoS than the name was published with.
    More,
}

/// Time for which a newly published name waits for its first reader, because messages without
/// readers are lost.
const FIRST_READER: Duration = Duration::from_secs(1);
/// Bound on the events of the topic that wait meanwhile.
const MAX_WAITING: usize = 256;

/// How often the route checks for the first reader.
const LOOK_FOR_READERS: Duration = Duration::from_millis(10);

/// The state of a topic whose type and QoS are known, from a publisher or the configuration.
struct Out<'a> {
    reader: Reader<'a>,
    roster: Outgoing<Key>,
    kind: Kind,
    format: Outbound,
    pace: Pace<Arrived>,
    /// The offer with which the name is published.
    offers: Offer,
    /// Events that occurred while the name had no reader.
    waiting: VecDeque<Event>,
    /// Publishers that are not carried, with the reason.
    incompatible_publishers: BTreeMap<Key, String>,
}

impl Route {
    pub(super) async fn run_out(
        &self,
        way: &Way<'_>,
        right: &mut Right<Issued<AdCert>>,
        publisher: &mut Option<Published>,
    ) -> Result<Infallible, RouteError> {
        let Way { node, card, candidate, .. } = *way;
        let mut out = self.learn(way, self.config.qos.map(Offer::from)).await?;
        let mut pause = RETRY;
        loop {
            let farewell = out.roster.farewell()?;
            let new = loop {
                let options = publish_options(&out.offers, &self.config);
                match node.publish(card.proof(), right.current(), options).await {
                    Ok(new) => break &mut publisher.insert(Published { publisher: new, farewell }).publisher,
                    Err(error) => self.pause(error, &mut pause, right, candidate).await,
                }
            };
            *self.fabric() = FabricCounters::Out(new.meter());
            pause = RETRY;
            self.is_up(candidate);
            self.show_out("up", &out.incompatible_publishers);
            out.roster.offers().for_each(|(number, offers)| new.latch(&roster::origin(number), latched_depth(&offers)));
            out.wait_for_reader(new).await?;
            let turn = self.carry_out(&mut out, new, right).await;
            out.reader.set_sink(None);
            let turn = turn?;
            let published = publisher.take();
            match turn {
                Turn::More => {
                    if let Some(published) = published {
                        self.close(published).await;
                    }
                    out.again()?;
                }
                Turn::Ended(error) => {
                    drop(published);
                    let offers = out.offers;
                    self.pause(error, &mut pause, right, candidate).await;
                    // The events of the old reader are stale by now.
                    out = self.learn(way, Some(offers)).await?;
                }
            }
        }
    }

    /// Reads the topic until its type and QoS are known. It never returns if the type cannot be
    /// converted as configured; the status then gives the reason.
    async fn learn<'a>(&self, way: &Way<'a>, offers: Option<Offer>) -> Result<Out<'a>, RouteError> {
        let Way { graph, kind, candidate, .. } = *way;
        let mut incompatible_publishers = BTreeMap::new();
        let mut reader = graph.reader(&self.config.topic, kind, self.config.qos)?;
        let wanted = kind.map(|kind| graph.kind(kind));
        let stated = wanted.clone().filter(|_| self.config.qos.is_some());
        let (first, kind, offered): (Option<(Key, Arc<str>)>, _, _) = match (stated, self.config.qos) {
            (Some(kind), Some(qos)) => (None, kind, qos.into()),
            _ => loop {
                self.show_out(Waiting::LocalPublisher.as_str(), &incompatible_publishers);
                match reader.next().await? {
                    Event::Joined { key, kind, node, offers } if wanted.as_ref().is_none_or(|it| it.agrees(&kind)) => {
                        incompatible_publishers.remove(&key);
                        break (Some((key, node)), kind, offers);
                    }
                    Event::Joined { key, kind, .. } => {
                        self.not_carried(&mut incompatible_publishers, key, of_another_type(&kind, wanted.as_ref()));
                    }
                    Event::Incompatible { key, why } => {
                        self.not_carried(&mut incompatible_publishers, key, why.to_string());
                    }
                    Event::Unreadable(why) => self.drop(Drop::Unreadable, why),
                    Event::Left(key) => _ = incompatible_publishers.remove(&key),
                    Event::Message(_) | Event::Liveliness { .. } => {}
                }
            },
        };
        self.route_status.set_kind(&kind.name);
        let definition = reader.definition().map(str::to_owned).or_else(|| self.types.definition(&kind));
        let format = match Outbound::new(&self.config, &self.types, &kind, definition.as_deref()) {
            Ok(format) => format,
            Err(error) => {
                self.route_status.set_status(&error.to_string());
                tracing::warn!(topic = %self.config.topic, kind = %kind.name, "not carried: {error}");
                // Another proxy of the graph may know the type.
                candidate.set_permitted(false);
                std::future::pending().await
            }
        };
        let mut roster = Outgoing::new(kind.clone(), definition);
        first.into_iter().for_each(|(key, node)| roster.joined(key, &node, offered));
        let offers = offers.map_or(offered, |before| merged(before, offered));
        Ok(Out {
            reader,
            roster,
            kind,
            format,
            pace: Pace::new(self.config.max_hz),
            offers,
            waiting: VecDeque::new(),
            incompatible_publishers,
        })
    }

    async fn carry_out(
        &self,
        out: &mut Out<'_>,
        publisher: &mut Publisher,
        right: &mut Right<Issued<AdCert>>,
    ) -> Result<Turn, RouteError> {
        let (mut told, mut ticks, mut ended) = (BTreeSet::new(), ticks(), pin!(publisher.ended()));
        let mut is_direct = false;
        loop {
            if let Some(error) = publisher.feedback().last()
                && told.insert(error.code.as_str())
            {
                self.tell(error);
            }
            self.announce(out, publisher);
            // After the roster, which names the publishers.
            if !std::mem::replace(&mut is_direct, true) {
                out.reader.set_sink(self.direct_out(out, publisher).as_ref());
            }
            let due = out.pace.next().into_iter().chain(out.roster.due()).min();
            let event = tokio::select! {
                event = out.next() => event?,
                why = &mut ended => return ended_because(why).map(Turn::Ended),
                () = until(due) => {
                    while let Some(arrived) = out.pace.overdue(Instant::now()) {
                        if let Some(error) = self.send(out, publisher, arrived).await? {
                            return Ok(Turn::Ended(error));
                        }
                    }
                    continue;
                }
                _ = ticks.tick() => {
                    self.route_status.renew(right, async |new| publisher.renew(new).await).await;
                    continue;
                }
            };
            is_direct = matches!(event, Event::Message(_) | Event::Liveliness { .. } | Event::Unreadable(_));
            match event {
                Event::Joined { key, kind, node, offers } => {
                    if !kind.agrees(&out.kind) {
                        let why = of_another_type(&kind, Some(&out.kind));
                        self.not_carried(&mut out.incompatible_publishers, key, why);
                        self.show_out("up", &out.incompatible_publishers);
                        continue;
                    }
                    if out.incompatible_publishers.remove(&key).is_some() {
                        self.show_out("up", &out.incompatible_publishers);
                    }
                    let offers = self.config.qos.map_or(offers, Offer::from);
                    out.roster.joined(key, &node, offers);
                    if let Some(number) = out.roster.number(&key) {
                        publisher.latch(&roster::origin(number), latched_depth(&offers));
                    }
                    let is_lacking = exceeds(&offers, &out.offers);
                    out.offers = merged(out.offers, offers);
                    if is_lacking {
                        return Ok(Turn::More);
                    }
                }
                Event::Incompatible { key, why } => {
                    self.not_carried(&mut out.incompatible_publishers, key, why.to_string());
                    self.show_out("up", &out.incompatible_publishers);
                }
                Event::Left(key) => {
                    if let Some(arrived) = out.pace.left(key)
                        && let Some(error) = self.send(out, publisher, arrived).await?
                    {
                        return Ok(Turn::Ended(error));
                    }
                    if out.incompatible_publishers.remove(&key).is_some() {
                        self.show_out("up", &out.incompatible_publishers);
                    }
                    if let Some(number) = out.roster.left(&key) {
                        publisher.forget(&roster::origin(number));
                    }
                }
                Event::Liveliness { key, alive } => out.roster.set_alive(&key, alive),
                Event::Unreadable(why) => self.drop(Drop::Unreadable, why),
                Event::Message(arrived) => {
                    if let Some(arrived) = self.paced(out, arrived)
                        && let Some(error) = self.send(out, publisher, arrived).await?
                    {
                        return Ok(Turn::Ended(error));
                    }
                }
            }
        }
    }

    /// Returns the message if it is to be sent now.
    fn paced(&self, out: &mut Out<'_>, arrived: Arrived) -> Option<Arrived> {
        self.drop_all(Drop::Lost, arrived.lost, "messages were lost before they came to the proxy");
        if let Some(written_ns) = arrived.written_ns {
            self.counters.arrival.record_since(written_ns);
        }
        if arrived.from.is_some_and(|key| out.incompatible_publishers.contains_key(&key)) {
            self.drop(Drop::Unconvertible, "its publisher uses another type");
            return None;
        }
        let (goes, replaced) = out.pace.take(Instant::now(), arrived.from, arrived);
        self.counters.dropped(Drop::MaxHz, replaced);
        goes
    }

    /// Returns the direct path of messages, unless they must be converted or limited in their rate.
    fn direct_out(&self, out: &Out<'_>, publisher: &Publisher) -> Option<ArrivalSink> {
        let encoding = out.format.unchanged().filter(|_| self.config.max_hz.is_none())?;
        let numbers = out.roster.numbers().filter(|(key, _)| !out.incompatible_publishers.contains_key(key));
        let origins = numbers.map(|(key, number)| (*key, roster::origin(number))).collect();
        let (sender, counters) = (publisher.immediate_sender(), self.counters.clone());
        Some(direct::Outward { sender, encoding, origins, counters }.into_sink())
    }

    /// Sends a roster, if one is due.
    fn announce(&self, out: &mut Out<'_>, publisher: &Publisher) {
        if let Err(error) = out.roster.announce(Instant::now(), publisher) {
            tracing::error!(topic = %self.config.topic, "no roster: {error}");
        }
    }

    /// Sends a message. Returns the error if it ended the right to publish.
    async fn send(
        &self,
        out: &mut Out<'_>,
        publisher: &mut Publisher,
        arrived: Arrived,
    ) -> Result<Option<NodeError>, RouteError> {
        let began = Instant::now();
        let Arrived { from, bytes, .. } = arrived;
        let body = match out.format.convert(bytes) {
            Ok(body) => body,
            Err(error) => {
                self.drop(Drop::Unconvertible, error);
                return Ok(None);
            }
        };
        let origin = from.and_then(|key| out.roster.number(&key)).map(roster::origin);
        let origin = origin.as_ref().map_or(&[][..], |origin| &origin[..]);
        let (encoding, carried) = out.format.pack(&body);
        let drafts = [Draft { origin, ..Draft::new(encoding, carried) }];
        let sending = publisher.send_batch(&drafts);
        // The send does not wait: without room, the message replaces older ones.
        let sent = match is_large(carried.len()) {
            true => tokio::task::block_in_place(|| Handle::current().block_on(sending)),
            false => sending.await,
        };
        match sent {
            Ok(_) => {
                self.counters.handling.record(began.elapsed());
                self.counters.passed(body.len(), carried.len());
                Ok(None)
            }
            Err(NodeError::Closed) => Err(RouteError::NodeClosed),
            Err(error) => {
                self.drop(Drop::SendFailed, &error);
                Ok(matches!(error, NodeError::Cert(_)).then_some(error))
            }
        }
    }

    /// Records why a publisher is not carried, and logs a new reason.
    fn not_carried(&self, publishers: &mut BTreeMap<Key, String>, key: Key, why: String) {
        if publishers.get(&key) != Some(&why) {
            tracing::warn!(topic = %self.config.topic, "a publisher here is not carried: {why}");
            publishers.insert(key, why);
        }
    }

    /// Shows in the status which publishers are not carried.
    fn show_out(&self, otherwise: &str, incompatible_publishers: &BTreeMap<Key, String>) {
        match incompatible_publishers.iter().next() {
            None => self.route_status.set_status(otherwise),
            Some((key, why)) => {
                let more = incompatible_publishers.len() - 1;
                let more = if more == 0 { String::new() } else { format!("; and {more} more") };
                self.route_status.set_status(&format!("publisher {key:x} here is not carried: {why}{more}"));
            }
        }
    }

    fn tell(&self, error: FrameError) {
        match error.code {
            // The normal case while nobody subscribes.
            ErrorCode::NoRoute => {
                tracing::info!(topic = %self.config.topic, name = %self.route_status.name(), "not carried on: {error}")
            }
            _ => {
                let name = self.route_status.name();
                tracing::warn!(topic = %self.config.topic, %name, "the switch refused a frame: {error}")
            }
        }
    }
}

impl Out<'_> {
    /// Returns the next event; those that waited come first. Safe to cancel.
    async fn next(&mut self) -> Result<Event, GraphError> {
        match self.waiting.pop_front() {
            Some(event) => Ok(event),
            None => self.reader.next().await,
        }
    }

    /// Queues events until the name has a reader, for [`FIRST_READER`] at most.
    async fn wait_for_reader(&mut self, publisher: &Publisher) -> Result<(), GraphError> {
        let over = Instant::now() + FIRST_READER;
        while publisher.readers() == 0 && Instant::now() < over && self.waiting.len() < MAX_WAITING {
            // `next` is safe to cancel.
            if let Ok(event) = tokio::time::timeout(LOOK_FOR_READERS, self.reader.next()).await {
                self.waiting.push_back(event?);
            }
        }
        Ok(())
    }

    /// Prepares to publish the name anew: the roster is sent again, and the transient-local history
    /// is read again.
    fn again(&mut self) -> Result<(), GraphError> {
        self.roster.again();
        self.reader.again()
    }
}

async fn until(when: Option<Instant>) {
    match when {
        Some(when) => tokio::time::sleep_until(when.into()).await,
        None => std::future::pending().await,
    }
}

fn of_another_type(kind: &Kind, wanted: Option<&Kind>) -> String {
    let wanted = wanted.map_or("another type", |wanted| &wanted.name);
    format!("it publishes {}, and the topic is of {wanted}", kind.name)
}
