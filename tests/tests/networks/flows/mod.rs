//! SDK nodes in namespaces, topics between them, and message flows: which messages were sent, which
//! arrived, and when.
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use gdp::unstable::{LinkStatus, Node, NodeConfig, PublishOptions, Publisher, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::domain::Credentials;
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::link_target::LinkTarget;
use gdp_e2e::seal::Encoding;
use gdp_e2e::transport::InboundCounters;
use gdp_tests::netns::Namespace;
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::Name;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::MissedTickBehavior;

use super::inside::{Inside, ROOT};

/// A node in a namespace.
pub struct Party {
    pub node: Node,
    pub identity: Identity,
    inside: Inside,
}

impl Party {
    /// Connects a node. `to`: its links, in order of preference.
    pub fn connect(at: &Namespace, identity: Identity, to: &[&str], papers: Option<Credentials>) -> Result<Self> {
        let inside = Inside::new(at, ROOT)?;
        let mut config = NodeConfig::new(identity.clone(), to[0].parse()?);
        for link in &to[1..] {
            config.links.push(link.parse::<LinkTarget>()?.into());
        }
        (config.connect_timeout, config.credentials) = (TIMEOUT, papers);
        let node = inside.run(Node::connect(config))??;
        Ok(Self { node, identity, inside })
    }

    pub fn wait_for_links(&self, condition: impl Fn(&[LinkStatus]) -> bool) -> Result<()> {
        let links = || self.node.links();
        wait_for("links", TIMEOUT, || Ok(condition(&links()).then_some(()))).with_context(|| format!("{:#?}", links()))
    }
}

/// A name with one writer and one reader.
pub struct Topic<'a> {
    from: &'a Party,
    to: &'a Party,
    pub publisher: Publisher,
    pub subscription: Subscription,
}

impl<'a> Topic<'a> {
    /// Opens a topic. `scope`: domains in which the reader may be, in addition to the writer's.
    pub fn open(
        from: &'a Party,
        to: &'a Party,
        scope: &[Name],
        out: PublishOptions,
        taken: SubscribeOptions,
    ) -> Result<Self> {
        let owner = SigningKey::generate()?;
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None)?;
        let (name, entity, not_after) = (card.name(), from.identity.name(), 4_000_000_000);
        let grant = Grantee::Entity(to.identity.name());
        let grant = ReadGrant { name, to: grant, serial: 1, not_before: 0, not_after };
        let scope = scope.to_vec();
        let cert = AdCert { name, entity, scope, serial: 1, not_before: 0, not_after };
        let subscribe = to.node.subscribe(card.proof(), issue(&owner, &grant)?.into(), taken);
        let subscription = to.inside.runtime.block_on(subscribe)?;
        let publish = from.node.publish(card.proof(), issue(&owner, &cert)?.into(), out);
        let publisher = from.inside.runtime.block_on(publish)?;
        wait_for("the reader to be known", TIMEOUT, || Ok((publisher.readers() == 1).then_some(())))?;
        Ok(Self { from, to, publisher, subscription })
    }

    pub fn send(&mut self) -> Result<()> {
        self.from.inside.runtime.block_on(self.publisher.send(Encoding::Bytes, &[1; 500]))?;
        Ok(())
    }

    /// Returns the sequence number of the next message.
    pub fn hear(&mut self) -> Result<u64> {
        let next = async { tokio::time::timeout(TIMEOUT, self.subscription.recv()).await };
        let message = self.to.inside.runtime.block_on(next).context("no message in time")?;
        Ok(message.context("the subscription ended")?.sequence)
    }
}

/// A message's number and its arrival time.
pub type Arrival = (u64, Instant);

/// A topic with periodic messages.
pub struct Flow<'a> {
    to: &'a Party,
    from: &'a Party,
    sending: JoinHandle<Result<u64>>,
    hearing: JoinHandle<Result<(Duration, InboundCounters)>>,
    stop: watch::Sender<bool>,
    last: watch::Sender<u64>,
    messages: Arc<Mutex<Vec<Arrival>>>,
}

/// The result of a flow.
pub struct Heard {
    pub messages: Vec<Arrival>,
    /// The longest time from the sealing of a message to the application.
    pub slowest: Duration,
    pub counters: InboundCounters,
    pub sent: u64,
}

impl<'a> Flow<'a> {
    /// Starts a flow of messages of `size` bytes, one per `period`.
    pub fn start(topic: Topic<'a>, size: usize, period: Duration) -> Self {
        let Topic { from, to, mut publisher, mut subscription } = topic;
        let (stop, last) = (watch::Sender::new(false), watch::Sender::new(u64::MAX));
        let (stopped, mut end, messages) = (stop.subscribe(), last.subscribe(), Arc::<Mutex<Vec<Arrival>>>::default());
        let sending = from.inside.runtime.spawn(async move {
            let (mut ticks, mut count, body) = (tokio::time::interval(period), 0, vec![1; size]);
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
            while !*stopped.borrow() {
                ticks.tick().await;
                count = publisher.send(Encoding::Bytes, &body).await?;
            }
            // Messages in flight still arrive.
            tokio::spawn(async move {
                let _publisher = publisher;
                std::future::pending::<()>().await
            });
            Ok(count)
        });
        let heard = messages.clone();
        let hearing = to.inside.runtime.spawn(async move {
            let (mut newest, mut slowest) = (0, Duration::ZERO);
            while newest < *end.borrow() {
                let message = tokio::select! {
                    message = subscription.recv() => message.context("the subscription ended")?,
                    _ = end.changed() => continue,
                };
                let now = SystemTime::now().duration_since(UNIX_EPOCH)?;
                slowest = slowest.max(now.saturating_sub(Duration::from_nanos(message.timestamp_ns)));
                newest = message.sequence;
                heard.lock().expect("no panic").push((newest, Instant::now()));
            }
            Ok((slowest, subscription.counters().inbound))
        });
        Self { to, from, sending, hearing, stop, last, messages }
    }

    pub fn heard(&self) -> usize {
        self.messages.lock().expect("no panic").len()
    }

    /// Returns the longest time without a message since `then`, so far.
    pub fn gap_since(&self, then: Instant) -> Duration {
        let messages = self.messages.lock().expect("no panic");
        let times: Vec<Instant> = messages.iter().map(|(_, at)| *at).collect();
        let gaps = times.windows(2).filter(|pair| pair[1] >= then).map(|pair| pair[1] - pair[0]);
        gaps.max().unwrap_or_default()
    }

    pub fn finish(self) -> Result<Heard> {
        self.stop.send_replace(true);
        let sent = self.from.inside.runtime.block_on(self.sending)??;
        self.last.send_replace(sent);
        let heard = async { tokio::time::timeout(TIMEOUT, self.hearing).await };
        let (slowest, counters) =
            self.to.inside.runtime.block_on(heard).context("the last message did not come")???;
        let messages = self.messages.lock().expect("no panic").clone();
        Ok(Heard { messages, slowest, counters, sent })
    }
}
