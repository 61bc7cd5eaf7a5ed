//! One topic in one direction. Each route has a thread of its own, so a slow topic holds up nobody else's; within it a
//! message goes straight from one side to the other, without a queue or a wake-up in between. A topic whose right has ended is
//! asked for again and again, and the others go on.

use std::collections::BTreeSet;
use std::convert::Infallible;
use std::fmt::Display;
use std::pin::pin;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use gdp::cert::{AdCert, Issued, Reading};
use gdp::node::{Ended, ErrorCode, FrameError, NodeError, Publisher, Subscription};
use gdp::seal::{Encoding, Message};
use gdp::{Name, NameCard, Node};
use tokio::time::{Interval, MissedTickBehavior};

use crate::cert_file::CertFile;
use crate::config::TopicConfig;
use crate::delivery;
use crate::material::{Permission, TopicMaterial};
use crate::ros2::{Arrived, Domain, RawReader, RawSample, RawWriter, RosError, TopicName, TypeName, WriteError};
use crate::stats::{Drop, FabricCounters, RouteCounters, RouteStats};

/// Between attempts to have a name published or subscribed: doubled from the first to the second.
const RETRY: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(30));

/// How often it is looked for another certificate.
const LOOK: Duration = Duration::from_secs(2);

/// How long a route that ends waits for what it has sent to arrive.
const FLUSH: Duration = Duration::from_secs(3);

pub struct Route {
    config: TopicConfig,
    name: Name,
    counters: RouteCounters,
    progress: Mutex<Progress>,
}

/// How far a route has come, for people and tests.
struct Progress {
    kind: Option<TypeName>,
    status: String,
    fabric: FabricCounters,
}

impl Route {
    pub fn new(config: &TopicConfig, material: &TopicMaterial) -> Self {
        Self {
            config: config.clone(),
            name: material.card.name(),
            counters: RouteCounters::default(),
            progress: Mutex::new(Progress {
                kind: material.kind.clone(),
                status: "starting".into(),
                fabric: FabricCounters::None,
            }),
        }
    }

    pub fn stats(&self) -> RouteStats {
        let progress = self.progress();
        let (kind, status) = (progress.kind.as_ref().map(TypeName::to_string), progress.status.clone());
        let fabric = progress.fabric.read();
        let TopicConfig { topic, direction, .. } = &self.config;
        RouteStats { fabric, ..RouteStats::new(topic.to_string(), kind, status, *direction, self.name, &self.counters) }
    }

    pub fn topic(&self) -> &TopicName {
        &self.config.topic
    }

    /// Carries messages until `stop` ends, or DDS fails or the node is closed. What has been sent by then arrives, if it can.
    pub async fn run(
        &self,
        domain: &Domain,
        node: &Node,
        material: TopicMaterial,
        stop: impl Future<Output = ()>,
    ) -> Result<(), RouteError> {
        let mut publisher = None;
        let result = tokio::select! {
            Err(error) = self.carry(domain, node, material, &mut publisher) => Err(error),
            () = stop => Ok(()),
        };
        if let Some(publisher) = publisher
            && let Err(error) = publisher.close(FLUSH).await
        {
            tracing::warn!(topic = %self.config.topic, name = %self.name, "left with messages under way: {error}");
        }
        result
    }

    async fn carry(
        &self,
        domain: &Domain,
        node: &Node,
        material: TopicMaterial,
        publisher: &mut Option<Publisher>,
    ) -> Result<Infallible, RouteError> {
        let TopicMaterial { card, kind, permission, file } = material;
        let kind = match kind {
            Some(kind) => kind,
            None => self.learn_type(domain).await,
        };
        match permission {
            Permission::Publish(cert) => self.run_out(domain, node, &kind, &card, (cert, file), publisher).await,
            Permission::Read(grant) => self.run_in(domain, node, &kind, &card, (grant, file)).await,
        }
    }

    async fn run_out(
        &self,
        domain: &Domain,
        node: &Node,
        kind: &TypeName,
        card: &NameCard,
        (mut cert, mut file): (Issued<AdCert>, CertFile),
        publisher: &mut Option<Publisher>,
    ) -> Result<Infallible, RouteError> {
        let (mut reader, mut pause) = (None, RETRY.0);
        loop {
            let options = delivery::publish_options(&self.config.qos, self.config.duplicate);
            let error = match node.publish(card.proof(), cert.clone(), options).await {
                Ok(new) => {
                    // First the fabric, then DDS: a latched message that comes at once has somewhere to go.
                    let reader = match &reader {
                        Some(reader) => reader,
                        None => reader.insert(domain.reader(&self.config.topic, kind, self.config.qos)?),
                    };
                    self.progress().fabric = FabricCounters::Out(new.meter());
                    pause = RETRY.0;
                    self.is_up();
                    let error = self.carry_out(reader, publisher.insert(new), &mut cert, &mut file).await?;
                    *publisher = None;
                    error
                }
                Err(error) => error,
            };
            self.pause_after(error, &mut pause).await;
            if let Some(new) = file.changed().and_then(Permission::publish) {
                cert = new;
                file.taken();
            }
        }
    }

    async fn run_in(
        &self,
        domain: &Domain,
        node: &Node,
        kind: &TypeName,
        card: &NameCard,
        (mut grant, mut file): (Reading, CertFile),
    ) -> Result<Infallible, RouteError> {
        // First DDS, then the fabric, likewise.
        let mut writer = domain.writer(&self.config.topic, kind, self.config.qos)?;
        let mut pause = RETRY.0;
        loop {
            let options = delivery::subscribe_options(&self.config.qos, self.config.duplicate);
            let error = match node.subscribe(card.proof(), grant.clone(), options).await {
                Ok(mut subscription) => {
                    self.progress().fabric = FabricCounters::In(subscription.meter());
                    pause = RETRY.0;
                    self.is_up();
                    let right = (&mut grant, &mut file);
                    self.carry_all_in(&mut subscription, node.name(), &mut writer, right).await?
                }
                Err(error) => error,
            };
            self.pause_after(error, &mut pause).await;
            if let Some(new) = file.changed().and_then(Permission::read) {
                grant = new;
                file.taken();
            }
        }
    }

    /// What came of showing the RIB another certificate. Whether it is in force.
    fn renewed(&self, file: &mut CertFile, result: Result<(), NodeError>) -> bool {
        match &result {
            Ok(()) => {
                file.taken();
                tracing::info!(topic = %self.config.topic, name = %self.name, "the certificate was renewed");
            }
            Err(error) => file.refused(error),
        }
        result.is_ok()
    }

    async fn learn_type(&self, domain: &Domain) -> TypeName {
        self.set_status("waiting for a local publisher, to learn the type");
        let kind = domain.type_of(&self.config.topic).await;
        tracing::info!(topic = %self.config.topic, %kind, "learnt the type");
        self.progress().kind = Some(kind.clone());
        kind
    }

    /// A refusal is no reason to end: other topics may be fine, and owners, RIBs and clocks mend.
    async fn pause_after(&self, error: NodeError, pause: &mut Duration) {
        let message = error.to_string();
        tracing::warn!(topic = %self.config.topic, name = %self.name, "{message}; asking again in {pause:?}");
        self.set_status(&message);
        tokio::time::sleep(*pause).await;
        *pause = (*pause * 2).min(RETRY.1);
    }

    /// Returns when the right to publish has ended, with the reason.
    async fn carry_out(
        &self,
        reader: &RawReader,
        publisher: &mut Publisher,
        cert: &mut Issued<AdCert>,
        file: &mut CertFile,
    ) -> Result<NodeError, RouteError> {
        let (mut told, mut ticks, mut ended) = (BTreeSet::new(), ticks(), pin!(publisher.ended()));
        loop {
            if let Some(error) = publisher.feedback().last()
                && told.insert(error.code.as_str())
            {
                self.tell(error);
            }
            let arrived = tokio::select! {
                arrived = reader.recv() => arrived,
                why = &mut ended => return ended_because(why),
                _ = ticks.tick() => {
                    if let Some(new) = file.changed().and_then(Permission::publish)
                        && self.renewed(file, publisher.renew(new.clone()).await)
                    {
                        *cert = new;
                    }
                    continue;
                }
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
        (grant, file): (&mut Reading, &mut CertFile),
    ) -> Result<NodeError, RouteError> {
        let mut ticks = ticks();
        loop {
            let received = tokio::select! {
                received = subscription.recv() => received,
                _ = ticks.tick() => {
                    if let Some(new) = file.changed().and_then(Permission::read)
                        && self.renewed(file, subscription.renew(new.clone()).await)
                    {
                        *grant = new;
                    }
                    continue;
                }
            };
            match received {
                Some(message) => self.carry_in(message, own, writer).await,
                None => return ended_because(subscription.ended().await),
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
            tracing::warn!(topic = %self.config.topic, reason = reason.as_str(), "a message was dropped: {why}");
        }
    }

    fn tell(&self, error: FrameError) {
        match error.code {
            // As long as nobody subscribes.
            ErrorCode::NoRoute => {
                tracing::info!(topic = %self.config.topic, name = %self.name, "not carried on: {error}")
            }
            _ => tracing::warn!(topic = %self.config.topic, name = %self.name, "the switch refused a frame: {error}"),
        }
    }

    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_up(&self) {
        tracing::info!(topic = %self.config.topic, direction = ?self.config.direction, name = %self.name, "carrying");
        self.set_status("up");
    }

    fn set_status(&self, status: &str) {
        self.progress().status = status.into();
    }
}

fn ended_because(why: Ended) -> Result<NodeError, RouteError> {
    match why {
        Ended::Right(error) => Ok(error.into()),
        Ended::Closed => Err(RouteError::NodeClosed),
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
