//! The SDK: a node is an entity attached to one switch, that publishes and subscribes to names.
//!
//! ```no_run
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! # let (identity, card, cert, key): (gdp::Identity, gdp::NameCard, _, gdp::seal::EpochKey) = todo!();
//! let node = gdp::Node::connect(gdp::NodeConfig::new(identity, "eth://r0".parse()?)).await?;
//! let mut publisher = node.publish(card.proof(), cert, &key).await?;
//! publisher.send(gdp::seal::Encoding::Bytes, b"hello").await?;
//! # Ok(()) }
//! ```
//!
//! What the switch and its RIB say is verified here again before it is believed: who may write a name follows from
//! certificates of the name's owner alone.

mod counters;
mod feedback;
mod frame_size;
mod held;
mod intake;
mod publisher;
mod receiver;
mod shared_entry;
mod state;
mod subscription;
mod supervisor;
mod target;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use gdp_wire::Name;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use self::intake::Intake;
use self::receiver::{Command, Receiver};
use self::state::{State, Statement, lock, unix_now};
use self::supervisor::Supervisor;
use crate::cert::{AdCert, CertError, ReadGrant, Signed};
use crate::control::{Record, RecordPlace, Refusal};
use crate::crypto::Backend;
use crate::identity::Identity;
use crate::link::{LinkError, RekeySchedule};
use crate::name::{NamePrefix, NameProof};
use crate::port::LinkAddr;
use crate::seal::{EpochKey, Reader, SealError, Writer};

pub use counters::NodeCounters;
pub use feedback::{Feedback, FrameError};
pub use gdp_wire::ErrorCode;
pub use publisher::Publisher;
pub use subscription::{SubscribeOptions, Subscription};
pub use target::{LinkTarget, LinkTargetError};

/// All writers of a name seal with the one key that they were given, for good.
const EPOCH: u32 = 0;

/// How a node finds its switch.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    pub identity: Identity,
    pub link: LinkTarget,
    /// The name that the switch must prove; without it, any switch at `link` is taken.
    pub switch: Option<Name>,
    /// How long [`Node::connect`] keeps trying.
    pub connect_timeout: Duration,
    /// When the keys of data frames are replaced.
    pub rekey: RekeySchedule,
}

impl NodeConfig {
    /// Any switch at `link`, waited for 10 s.
    pub fn new(identity: Identity, link: LinkTarget) -> Self {
        let (connect_timeout, rekey) = (Duration::from_secs(10), RekeySchedule::default());
        Self { identity, link, switch: None, connect_timeout, rekey }
    }
}

/// Why a node could not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("no answer from {wanted} on interface {interface}; is it running there, and is the cable plugged in?")]
    NoAnswer { interface: String, wanted: String },
    #[error("host {host} has no address: {source}; check the name, and that the network is up")]
    NoAddress { host: String, source: std::io::Error },
    #[error("who answered on the segment is not the switch that it says: {0}")]
    NoSwitch(Box<NodeError>),
    #[error("the peer at {0} is no switch")]
    NotASwitch(LinkAddr),
    #[error("refused: {0}")]
    Refused(#[from] Refusal),
    #[error(transparent)]
    Cert(#[from] CertError),
    #[error(transparent)]
    Seal(#[from] SealError),
    #[error("there is no link to the switch at the moment: {0}")]
    Detached(String),
    #[error("{name:#} is {stated} by this node already; share the handle")]
    Already { name: Name, stated: Stated },
    #[error("{lost} of the message's {of} frames found no room in the kernel's queue; send less at a time")]
    NoRoom { lost: usize, of: usize },
    #[error("the switch answered another question: {0}")]
    Protocol(&'static str),
    #[error("the node is closed")]
    Closed,
}

/// What a node can state about a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stated {
    Published,
    Subscribed,
}

impl std::fmt::Display for Stated {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Published => "published",
            Self::Subscribed => "subscribed to",
        })
    }
}

/// An attached entity. Clones are the same node; it detaches when the last of them and of what it handed out is dropped.
#[derive(Clone)]
pub struct Node(Arc<Handle>);

/// What keeps the node running.
struct Handle {
    state: Arc<State>,
    stop: watch::Sender<bool>,
    supervisor: Mutex<Option<JoinHandle<()>>>,
}

impl Node {
    /// Makes a link to the switch and attaches. Call within a tokio runtime.
    pub async fn connect(config: NodeConfig) -> Result<Self, NodeError> {
        let (commands, command_queue) = std::sync::mpsc::channel();
        let (events, event_queue) = mpsc::unbounded_channel();
        let state = Arc::new(State::new(config.identity, commands, events.clone()));
        let receiver = Receiver {
            commands: command_queue,
            events,
            counters: state.counters.clone(),
            feedback: state.feedback.clone(),
        };
        std::thread::Builder::new()
            .name("gdp-receive".into())
            .spawn(move || receiver.run())
            .map_err(|source| LinkError::Io { what: "receiving thread".into(), source })?;

        let mut supervisor = Supervisor::new(state.clone(), config.link, config.switch, config.rekey);
        let first = supervisor.connect(config.connect_timeout).await?;
        let stop = watch::Sender::new(false);
        let task = tokio::spawn(supervisor.run(first, event_queue, stop.subscribe()));
        Ok(Self(Arc::new(Handle { state, stop, supervisor: Mutex::new(Some(task)) })))
    }

    /// Publishes a name: `proof` shows how it is derived, `ad_cert` that its owner allows it, `key` seals the messages.
    pub async fn publish(
        &self,
        proof: NameProof,
        ad_cert: Signed<AdCert>,
        key: &EpochKey,
    ) -> Result<Publisher, NodeError> {
        let state = &self.0.state;
        let name = proof.name().map_err(CertError::from)?;
        let claims = ad_cert.verify(&proof.verify_key().map_err(CertError::from)?, unix_now())?;
        state.check_own(name, claims.name, claims.entity)?;
        let entity = state.identity.name();
        let mut writer = Writer::new(name, entity, state.identity.key().clone(), Backend::default())?;
        writer.set_epoch(EPOCH, key)?;
        state.begin(name, Stated::Published, Statement::Publish { proof, ad_cert })?;
        let publisher = Publisher::new(self.0.clone(), name, writer, state.feedback.of(name));
        // From here on, dropping the publisher ends the statement.
        let attachment = state.attached().await?;
        state.state(&attachment, name, Stated::Published).await?;
        Ok(publisher)
    }

    /// Subscribes to a name: `grant` shows that its owner allows it, `key` opens the messages.
    pub async fn subscribe(
        &self,
        proof: NameProof,
        grant: Signed<ReadGrant>,
        key: &EpochKey,
        options: SubscribeOptions,
    ) -> Result<Subscription, NodeError> {
        let state = &self.0.state;
        let name = proof.name().map_err(CertError::from)?;
        let claims = grant.verify(&proof.verify_key().map_err(CertError::from)?, unix_now())?;
        state.check_own(name, claims.name, claims.entity)?;
        state.begin(name, Stated::Subscribed, Statement::Subscribe { proof, grant })?;
        let (sender, queue) = mpsc::channel(options.queue.max(1));
        let mut reader = Reader::new(name, Backend::default(), options.limits);
        reader.vouch_on_sight();
        let queued_bytes = Arc::default();
        let intake = Intake::new(reader, key, sender, Arc::clone(&queued_bytes), options.queue_bytes);
        state.command(Command::Subscribe { name, intake: Box::new(intake) });
        let subscription = Subscription::new(self.0.clone(), name, queue, queued_bytes);
        let attachment = state.attached().await?;
        state.state(&attachment, name, Stated::Subscribed).await?;
        Ok(subscription)
    }

    /// Who publishes and reads the names with this prefix, as far as it verifies: as many as fit an answer, from the one behind
    /// `after` on; and whether there are more.
    pub async fn query(
        &self,
        prefix: NamePrefix,
        after: Option<RecordPlace>,
    ) -> Result<(Vec<Record>, bool), NodeError> {
        let state = &self.0.state;
        let attachment = state.attached().await?;
        let (mut records, truncated) = state.query(&attachment, prefix.clone(), after).await?;
        records.retain(|record| {
            let verdict = record.verify(unix_now());
            if let Err(error) = &verdict {
                tracing::warn!(name = %record.name, %error, "the RIB answered with a record that does not verify");
            }
            verdict.is_ok() && prefix.matches(&record.name)
        });
        Ok((records, truncated))
    }

    /// This entity's name.
    pub fn name(&self) -> Name {
        self.0.state.identity.name()
    }

    /// The switch the node is attached to at the moment; `Err` says why there is none.
    pub fn switch(&self) -> Result<Name, NodeError> {
        self.0.state.attached_now().map(|attachment| attachment.link.peer().name)
    }

    /// What became of frames and messages so far.
    pub fn counters(&self) -> NodeCounters {
        let state = &self.0.state;
        let socket_drops = state.sending_on().map_or(0, |attachment| attachment.data.receive_drops());
        state.counters.snapshot(socket_drops)
    }

    /// Detaches: the switch is told, and withdraws everything at once. Publishers and subscriptions are of no use after.
    pub async fn close(&self) {
        self.0.stop.send_replace(true);
        let task = lock(&self.0.supervisor).take();
        if let Some(task) = task {
            let _ = task.await;
        }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        self.stop.send_replace(true);
    }
}

#[cfg(test)]
mod tests;
