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
mod held;
mod intake;
mod publisher;
mod receiver;
mod subscription;
mod supervisor;
mod target;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, SystemTime};

use gdp_wire::Name;
use tokio::sync::{Notify, mpsc, watch};
use tokio::task::JoinHandle;

use self::counters::Counters;
use self::intake::{Intake, Writer as KnownWriter};
use self::receiver::{Command, Receiver};
use self::supervisor::{Attachment, Event, Supervisor};
use crate::cert::{AdCert, Advert, AdvertOp, CertError, ReadGrant, RtCert, Signed, issue};
use crate::control::{Credential, EntityRequest, Record, Refusal, RefusalCode, Request, Response};
use crate::crypto::Backend;
use crate::identity::Identity;
use crate::link::LinkError;
use crate::name::{NamePrefix, NameProof};
use crate::port::LinkAddr;
use crate::seal::{EpochKey, Reader, SealError, Writer};

pub use counters::NodeCounters;
pub use publisher::Publisher;
pub use subscription::{SubscribeOptions, Subscription};
pub use target::{LinkTarget, LinkTargetError};

/// Seconds that certificates for the switch and statements to the RIB hold; they are renewed long before.
const LIFETIME: u32 = 24 * 3600;

/// How long a request waits for a link that is lost.
const LINK_PATIENCE: Duration = Duration::from_secs(10);

/// How a node finds its switch.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    pub identity: Identity,
    pub link: LinkTarget,
    /// The name that the switch must prove; without it, any switch at `link` is taken.
    pub switch: Option<Name>,
    /// How long [`Node::connect`] keeps trying.
    pub connect_timeout: Duration,
}

impl NodeConfig {
    /// Any switch at `link`, waited for 10 s.
    pub fn new(identity: Identity, link: LinkTarget) -> Self {
        Self { identity, link, switch: None, connect_timeout: Duration::from_secs(10) }
    }
}

/// Why a node could not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("no answer from {wanted} on interface {interface}; is it running there, and is the cable plugged in?")]
    NoAnswer { interface: String, wanted: String },
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

/// What the handles, the supervisor and its tasks share.
struct State {
    identity: Identity,
    counters: Arc<Counters>,
    status: watch::Sender<Status>,
    /// Everything the RIB is to know, stated again after each reconnection; and whether it was, on the present link.
    statements: Mutex<HashMap<(Name, Stated), (Statement, bool)>>,
    /// Something that stands has to be stated again.
    unstated: Notify,
    /// The highest serial used. Held while a statement is on its way, so that they arrive in their order.
    serial: tokio::sync::Mutex<u64>,
    commands: std::sync::mpsc::Sender<Command>,
    events: mpsc::UnboundedSender<Event>,
}

#[derive(Clone)]
enum Status {
    Down(String),
    Up(Arc<Attachment>),
    Closed,
}

/// The right to a name, as it is shown to the RIB.
#[derive(Clone)]
enum Statement {
    Publish { proof: NameProof, ad_cert: Signed<AdCert> },
    Subscribe { proof: NameProof, grant: Signed<ReadGrant> },
}

impl Node {
    /// Makes a link to the switch and attaches. Call within a tokio runtime.
    pub async fn connect(config: NodeConfig) -> Result<Self, NodeError> {
        let (commands, command_queue) = std::sync::mpsc::channel();
        let (events, event_queue) = mpsc::unbounded_channel();
        let counters = Arc::new(Counters::default());
        let state = Arc::new(State {
            identity: config.identity,
            counters: counters.clone(),
            status: watch::Sender::new(Status::Down("connecting".into())),
            statements: Mutex::default(),
            unstated: Notify::new(),
            serial: tokio::sync::Mutex::new(0),
            commands,
            events: events.clone(),
        });
        let receiver = Receiver { commands: command_queue, events, counters };
        std::thread::Builder::new()
            .name("gdp-receive".into())
            .spawn(move || receiver.run())
            .map_err(|source| LinkError::Io { what: "receiving thread".into(), source })?;

        let mut supervisor = Supervisor::new(state.clone(), config.link, config.switch);
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
        let writer = Writer::new(name, entity, key, state.identity.key().clone(), Backend::default())?;
        state.begin(name, Stated::Published, Statement::Publish { proof, ad_cert })?;
        let publisher = Publisher::new(self.0.clone(), name, writer);
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
        let reader = Reader::new(name, key, Backend::default(), options.limits);
        let queued_bytes = Arc::default();
        let intake = Intake::new(reader, sender, Arc::clone(&queued_bytes), options.queue_bytes, options.max_age);
        state.command(Command::Subscribe { name, intake: Box::new(intake) });
        let subscription = Subscription::new(self.0.clone(), name, queue, queued_bytes);
        let attachment = state.attached().await?;
        state.state(&attachment, name, Stated::Subscribed).await?;
        Ok(subscription)
    }

    /// Who publishes and reads the names with this prefix, as far as it verifies; and whether there are more.
    pub async fn query(&self, prefix: NamePrefix) -> Result<(Vec<Record>, bool), NodeError> {
        let state = &self.0.state;
        let attachment = state.attached().await?;
        let (mut records, truncated) = state.query(&attachment, prefix.clone()).await?;
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
        let socket_drops = state.attached_now().map_or(0, |attachment| attachment.data.receive_drops());
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

impl State {
    fn set_status(&self, status: Status) {
        self.status.send_replace(status);
    }

    fn command(&self, command: Command) {
        // The thread ends only once this node is closed.
        let _ = self.commands.send(command);
        if let Ok(attachment) = self.attached_now() {
            attachment.data.wake();
        }
    }

    /// The link, if it is up at this moment.
    fn attached_now(&self) -> Result<Arc<Attachment>, NodeError> {
        match &*self.status.borrow() {
            Status::Up(attachment) => Ok(attachment.clone()),
            Status::Down(reason) => Err(NodeError::Detached(reason.clone())),
            Status::Closed => Err(NodeError::Closed),
        }
    }

    /// The link, waiting for it a while.
    async fn attached(&self) -> Result<Arc<Attachment>, NodeError> {
        let mut status = self.status.subscribe();
        let settled = status.wait_for(|status| !matches!(status, Status::Down(_)));
        let _ = tokio::time::timeout(LINK_PATIENCE, settled).await;
        self.attached_now()
    }

    fn check_own(&self, name: Name, certified_name: Name, certified_entity: Name) -> Result<(), CertError> {
        let entity = self.identity.name();
        if certified_name != name {
            return Err(CertError::WrongName { expected: name, got: certified_name });
        }
        if certified_entity != entity {
            return Err(CertError::WrongEntity { expected: entity, got: certified_entity });
        }
        Ok(())
    }

    fn begin(&self, name: Name, stated: Stated, statement: Statement) -> Result<(), NodeError> {
        match lock(&self.statements).entry((name, stated)) {
            std::collections::hash_map::Entry::Occupied(_) => Err(NodeError::Already { name, stated }),
            std::collections::hash_map::Entry::Vacant(entry) => {
                entry.insert((statement, false));
                Ok(())
            }
        }
    }

    fn subscribes_to(&self, name: &Name) -> bool {
        lock(&self.statements).contains_key(&(*name, Stated::Subscribed))
    }

    /// A handle was dropped. The RIB is told by the supervisor, or by the loss of the link.
    fn withdraw(&self, name: Name, stated: Stated) {
        lock(&self.statements).remove(&(name, stated));
        if stated == Stated::Subscribed {
            self.command(Command::Unsubscribe { name });
        }
        let _ = self.events.send(Event::Withdraw { name, stated });
    }

    /// Lets the switch carry this entity's traffic, and learns the serial that the next statement must exceed.
    async fn attach(&self, attachment: &Attachment) -> Result<(), NodeError> {
        let mut serial = self.serial.lock().await;
        self.attach_locked(attachment, &mut serial).await?;
        lock(&self.statements).values_mut().for_each(|(_, done)| *done = false);
        Ok(())
    }

    async fn attach_locked(&self, attachment: &Attachment, serial: &mut u64) -> Result<(), NodeError> {
        let switch = attachment.link.peer().name;
        let not_after = unix_now() + u64::from(LIFETIME);
        let rt_cert = issue(self.identity.key(), &RtCert { entity: self.identity.name(), switch, not_after })?;
        match ask(attachment, EntityRequest::Attach { rt_cert }).await? {
            Response::Attached { serial: floor } => *serial = floor.max(*serial),
            _ => return Err(NodeError::Protocol("to an attachment")),
        }
        Ok(())
    }

    /// States one thing that stands to the RIB, unless that is done since the last [`Self::attach`].
    async fn state(&self, attachment: &Attachment, name: Name, stated: Stated) -> Result<(), NodeError> {
        let mut serial = self.serial.lock().await;
        let Some((statement, false)) = lock(&self.statements).get(&(name, stated)).cloned() else { return Ok(()) };
        let op = match statement {
            Statement::Publish { .. } => AdvertOp::Publish,
            Statement::Subscribe { .. } => AdvertOp::Subscribe,
        };
        let response = self.ask_signed(attachment, &mut serial, op, name, |advert| match statement.clone() {
            Statement::Publish { proof, ad_cert } => EntityRequest::Advertise { proof, ad_cert, advert },
            Statement::Subscribe { proof, grant } => EntityRequest::Subscribe { proof, grant, advert },
        });
        if let Response::Records { records, .. } = response.await? {
            self.authorise(name, &records);
        }
        if let Some((_, done)) = lock(&self.statements).get_mut(&(name, stated)) {
            *done = true;
        }
        Ok(())
    }

    /// States everything that stands; `false` if something was refused or did not get through, and should be tried again.
    async fn state_all(&self, attachment: &Attachment) -> bool {
        let standing: Vec<_> = lock(&self.statements).keys().copied().collect();
        let mut all = true;
        for (name, stated) in standing {
            if let Err(error) = self.state(attachment, name, stated).await {
                tracing::warn!(%name, %error, "could not be {stated} again");
                all = false;
            }
        }
        all
    }

    /// Withdraws a name. What else stands about it goes with it, and is to be stated again.
    async fn state_withdrawal(&self, attachment: &Attachment, name: Name, stated: Stated) -> Result<(), NodeError> {
        let mut serial = self.serial.lock().await;
        if lock(&self.statements).contains_key(&(name, stated)) {
            return Ok(());
        }
        let request = |advert| EntityRequest::Withdraw { advert };
        self.ask_signed(attachment, &mut serial, AdvertOp::Withdraw, name, request).await?;
        for other in [Stated::Published, Stated::Subscribed] {
            if let Some((_, done)) = lock(&self.statements).get_mut(&(name, other)) {
                *done = false;
                self.unstated.notify_one();
            }
        }
        Ok(())
    }

    async fn query(&self, attachment: &Attachment, prefix: NamePrefix) -> Result<(Vec<Record>, bool), NodeError> {
        match ask(attachment, EntityRequest::Query { prefix }).await? {
            Response::Records { records, truncated } => Ok((records, truncated)),
            _ => Err(NodeError::Protocol("to a query")),
        }
    }

    /// Asks the RIB who writes a name.
    async fn learn_writers(&self, attachment: &Attachment, name: Name) -> Result<(), NodeError> {
        let (records, _) = self.query(attachment, name.into()).await?;
        self.authorise(name, &records);
        Ok(())
    }

    /// Has the reader of `name` believe those of the records' writers that verify.
    fn authorise(&self, name: Name, records: &[Record]) {
        let writers: Vec<KnownWriter> = records
            .iter()
            .filter(|record| record.name == name)
            .filter_map(|record| match verified_writer(record) {
                Ok(writer) => writer,
                Err(error) => {
                    tracing::warn!(%name, %error, "a record of a writer does not verify");
                    None
                }
            })
            .collect();
        if !writers.is_empty() {
            self.command(Command::Authorise { name, writers });
        }
    }

    /// Asks with a statement of this entity, under the next serial; and once more under a higher one if something else spoke
    /// for the entity since it attached, such as a command-line tool.
    async fn ask_signed(
        &self,
        attachment: &Attachment,
        serial: &mut u64,
        op: AdvertOp,
        name: Name,
        request: impl Fn(Signed<Advert>) -> EntityRequest,
    ) -> Result<Response, NodeError> {
        match ask(attachment, request(self.advert(attachment, op, name, serial)?)).await {
            Err(NodeError::Refused(refusal)) if refusal.code == RefusalCode::ReplayedSerial => {
                self.attach_locked(attachment, serial).await?;
                ask(attachment, request(self.advert(attachment, op, name, serial)?)).await
            }
            result => result,
        }
    }

    fn advert(
        &self,
        attachment: &Attachment,
        op: AdvertOp,
        name: Name,
        serial: &mut u64,
    ) -> Result<Signed<Advert>, NodeError> {
        *serial = serial.saturating_add(1);
        let (entity, switch) = (self.identity.name(), attachment.link.peer().name);
        Ok(issue(self.identity.key(), &Advert { op, name, entity, switch, serial: *serial, lifetime: LIFETIME })?)
    }
}

async fn ask(attachment: &Attachment, request: EntityRequest) -> Result<Response, NodeError> {
    Ok(attachment.link.request(&Request::Entity(request)).await?.accepted()?)
}

/// The writer that a record is of, if it is one of a writer.
fn verified_writer(record: &Record) -> Result<Option<KnownWriter>, CertError> {
    let Credential::Writer(cert) = &record.credential else { return Ok(None) };
    let entity = record.verify(unix_now())?;
    let not_after = cert.claims_unverified()?.not_after;
    Ok(Some(KnownWriter { entity, key: record.entity.verify_key()?, not_after }))
}

/// Unix seconds.
fn unix_now() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |time| time.as_secs())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

#[cfg(test)]
mod tests;
