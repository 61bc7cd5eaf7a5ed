//! One topic in one direction. Each route has a thread of its own, so a slow topic holds up nobody else's; within it a
//! message goes straight from one side to the other, without a queue or a wake-up in between. A topic whose right has ended is
//! asked for again and again, and the others go on.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::fmt::Display;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use gdp::cert::{AdCert, Issued, Reading};
use gdp::node::{ErrorCode, Feedback, FrameError, NodeError, Publisher, Subscription};
use gdp::seal::{Encoding, Message};
use gdp::{Name, NameCard, Node};
use tokio::time::{Interval, MissedTickBehavior};

use crate::config::{Direction, TopicConfig};
use crate::delivery;
use crate::material::{Permission, TopicMaterial};
use crate::ros2::{Arrived, Domain, Qos, RawReader, RawSample, RawWriter, RosError, TopicName, TypeName, WriteError};
use crate::stats::{Drop, FabricCounters, RouteCounters, RouteStats};

/// Between attempts to have a name published or subscribed: doubled from the first to the second.
const RETRY: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(30));

/// How old what the statistics say of the fabric may be.
const LOOK: Duration = Duration::from_secs(1);

pub struct Route {
    topic: TopicName,
    direction: Direction,
    qos: Qos,
    duplicate: bool,
    name: Name,
    counters: RouteCounters,
    progress: Mutex<Progress>,
}

/// How far a route has come, for people and tests.
struct Progress {
    kind: Option<TypeName>,
    status: String,
    /// Of the publisher, once there is one.
    feedback: Option<Arc<Feedback>>,
    fabric: FabricCounters,
}

impl Route {
    pub fn new(config: &TopicConfig, material: &TopicMaterial) -> Self {
        Self {
            topic: config.topic.clone(),
            direction: config.direction,
            qos: config.qos,
            duplicate: config.duplicate,
            name: material.card.name(),
            counters: RouteCounters::default(),
            progress: Mutex::new(Progress {
                kind: material.kind.clone(),
                status: "starting".into(),
                feedback: None,
                fabric: FabricCounters::None,
            }),
        }
    }

    pub fn stats(&self) -> RouteStats {
        let progress = self.progress();
        let (kind, status) = (progress.kind.as_ref().map(TypeName::to_string), progress.status.clone());
        let refused = progress.feedback.as_ref().map(|feedback| feedback.errors()).unwrap_or_default();
        RouteStats {
            refused,
            fabric: progress.fabric.by_name(),
            ..RouteStats::new(self.topic.to_string(), kind, status, self.direction, self.name, &self.counters)
        }
    }

    pub fn topic(&self) -> &TopicName {
        &self.topic
    }

    /// Carries messages until it is dropped, or DDS fails or the node is closed.
    pub async fn run(&self, domain: &Domain, node: &Node, material: TopicMaterial) -> Result<Infallible, RouteError> {
        let kind = match material.kind.clone() {
            Some(kind) => kind,
            None => self.learn_type(domain).await,
        };
        match &material.permission {
            Permission::Publish(cert) => self.run_out(domain, node, &kind, &material.card, cert).await,
            Permission::Read(grant) => self.run_in(domain, node, &kind, &material.card, grant).await,
        }
    }

    async fn run_out(
        &self,
        domain: &Domain,
        node: &Node,
        kind: &TypeName,
        card: &NameCard,
        cert: &Issued<AdCert>,
    ) -> Result<Infallible, RouteError> {
        let (mut reader, mut pause) = (None, RETRY.0);
        loop {
            let error = match node
                .publish(card.proof(), cert.clone(), delivery::publish_options(&self.qos, self.duplicate))
                .await
            {
                Ok(mut publisher) => {
                    // First the fabric, then DDS: a latched message that comes at once has somewhere to go.
                    let reader = match &reader {
                        Some(reader) => reader,
                        None => reader.insert(domain.reader(&self.topic, kind, self.qos)?),
                    };
                    self.progress().feedback = Some(publisher.feedback().clone());
                    pause = RETRY.0;
                    self.is_up();
                    self.carry_out(reader, &mut publisher).await?
                }
                Err(error) => error,
            };
            self.pause_after(error, &mut pause).await;
        }
    }

    async fn run_in(
        &self,
        domain: &Domain,
        node: &Node,
        kind: &TypeName,
        card: &NameCard,
        grant: &Reading,
    ) -> Result<Infallible, RouteError> {
        // First DDS, then the fabric, likewise.
        let mut writer = domain.writer(&self.topic, kind, self.qos)?;
        let mut pause = RETRY.0;
        loop {
            let options = delivery::subscribe_options(&self.qos, self.duplicate);
            let error = match node.subscribe(card.proof(), grant.clone(), options).await {
                Ok(mut subscription) => {
                    pause = RETRY.0;
                    self.is_up();
                    self.carry_all_in(&mut subscription, node.name(), &mut writer).await?
                }
                Err(error) => error,
            };
            self.pause_after(error, &mut pause).await;
        }
    }

    async fn learn_type(&self, domain: &Domain) -> TypeName {
        self.set_status("waiting for a local publisher, to learn the type");
        let kind = domain.type_of(&self.topic).await;
        tracing::info!(topic = %self.topic, %kind, "learnt the type");
        self.progress().kind = Some(kind.clone());
        kind
    }

    /// A refusal is no reason to end: other topics may be fine, and owners, RIBs and clocks mend.
    async fn pause_after(&self, error: NodeError, pause: &mut Duration) {
        let message = error.to_string();
        tracing::warn!(topic = %self.topic, name = %self.name, "{message}; asking again in {pause:?}");
        self.set_status(&message);
        tokio::time::sleep(*pause).await;
        *pause = (*pause * 2).min(RETRY.1);
    }

    /// Returns when the right to publish has ended, with the reason.
    async fn carry_out(&self, reader: &RawReader, publisher: &mut Publisher) -> Result<NodeError, RouteError> {
        let (mut told, mut ticks) = (BTreeSet::new(), ticks());
        loop {
            if let Some(error) = publisher.feedback().last()
                && told.insert(error.code.as_str())
            {
                self.tell(error);
            }
            self.progress().fabric = FabricCounters::Out(publisher.counters());
            let arrived = tokio::select! {
                arrived = reader.recv() => arrived,
                _ = ticks.tick() => continue,
            };
            let Arrived { sample, written_ns } = match arrived {
                Ok(arrived) => arrived,
                Err(error) => {
                    self.drop(Drop::Unreadable, error);
                    continue;
                }
            };
            if let Some(written_ns) = written_ns {
                self.counters.arrival.record_since(written_ns);
            }
            let began = Instant::now();
            // Waits for nothing: what finds no room replaces older messages.
            match publisher.send(Encoding::Cdr, &sample.bytes).await {
                Ok(_) => {
                    self.counters.handling.record(began.elapsed());
                    self.counters.passed(sample.bytes.len());
                }
                Err(NodeError::Closed) => return Err(RouteError::NodeClosed),
                Err(error @ NodeError::Cert(_)) => {
                    self.drop(Drop::SendFailed, &error);
                    return Ok(error);
                }
                Err(error) => self.drop(Drop::SendFailed, error),
            }
        }
    }

    /// Returns when the right to read has ended, with the reason.
    async fn carry_all_in(
        &self,
        subscription: &mut Subscription,
        own: Name,
        writer: &mut RawWriter,
    ) -> Result<NodeError, RouteError> {
        let mut ticks = ticks();
        loop {
            self.progress().fabric = FabricCounters::In(subscription.counters(), subscription.queue_full());
            let received = tokio::select! {
                received = subscription.recv() => received,
                _ = ticks.tick() => continue,
            };
            match received {
                Some(message) => self.carry_in(message, own, writer).await,
                None => {
                    let ended = subscription.ended().cloned();
                    return ended.map(NodeError::from).ok_or(RouteError::NodeClosed);
                }
            }
        }
    }

    async fn carry_in(&self, message: Message, own: Name, writer: &mut RawWriter) {
        if message.writer == own {
            return self.drop(Drop::Own, "this proxy wrote it");
        }
        if message.encoding != Encoding::Cdr {
            return self.drop(Drop::WrongEncoding, format_args!("{:?}, not CDR", message.encoding));
        }
        self.counters.arrival.record_since(message.timestamp_ns);
        let (bytes, began) = (message.body.len(), Instant::now());
        let Some(sample) = RawSample::parse(message.body) else {
            return self.drop(Drop::Malformed, "not a CDR encapsulation");
        };
        match writer.write(sample, message.timestamp_ns).await {
            Ok(()) => {
                self.counters.handling.record(began.elapsed());
                self.counters.passed(bytes);
            }
            Err(error @ WriteError::Stalled) => self.drop(Drop::Stalled, error),
            Err(error @ WriteError::Failed(_)) => self.drop(Drop::WriteFailed, error),
        }
    }

    /// Counts every drop; the first one for a reason is worth a line in the log, the counters have the rest.
    fn drop(&self, reason: Drop, why: impl Display) {
        if self.counters.dropped(reason) {
            tracing::warn!(topic = %self.topic, reason = reason.as_str(), "a message was dropped: {why}");
        }
    }

    fn tell(&self, error: FrameError) {
        match error.code {
            // As long as nobody subscribes.
            ErrorCode::NoRoute => tracing::info!(topic = %self.topic, name = %self.name, "not carried on: {error}"),
            _ => tracing::warn!(topic = %self.topic, name = %self.name, "the switch refused a frame: {error}"),
        }
    }

    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_up(&self) {
        tracing::info!(topic = %self.topic, direction = ?self.direction, name = %self.name, "carrying");
        self.set_status("up");
    }

    fn set_status(&self, status: &str) {
        self.progress().status = status.into();
    }
}

fn ticks() -> Interval {
    let mut ticks = tokio::time::interval(LOOK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

/// Why a route ended.
#[derive(Debug, thiserror::Error)]
pub enum RouteError {
    #[error(transparent)]
    Ros(#[from] RosError),
    #[error("the node is closed")]
    NodeClosed,
}
