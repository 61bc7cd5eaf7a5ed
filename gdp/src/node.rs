//! The SDK: a node is an entity attached to a switch, by one link or several, that publishes and
//! subscribes to names.
//!
//! What the switch and its RIB say is verified here again before it is believed: who may write a
//! name follows from certificates of the name's owner alone.

mod abort_on_drop;
mod attachment;
mod choice;
mod clock;
mod counters;
mod ending;
mod feedback;
mod frame_size;
mod greeting;
mod held;
mod home;
mod inbox;
mod lane;
mod latched;
mod message_batch;
mod network;
mod options;
mod pairs;
mod pause;
mod publication;
mod publisher;
mod reading;
mod receiver;
mod request_queue;
mod revoked;
mod send_path;
mod service_instances;
mod services;
mod shared_entry;
mod state;
mod subscription;
mod subscription_receiver;
mod supervisor;
mod told;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;

use self::home::Home;
use self::lane::Status;
use self::publication::Publication;
use self::receiver::Receiver;
use self::revoked::Revoked;
use self::state::{State, Statement};
use gdp_core::cert::{AdCert, CertError, Issued, Reading as Grant};
use gdp_core::domain::{Credentials, DomainError};
use gdp_core::identity::Identity;
use gdp_core::name::{NamePrefix, NameProof};
use gdp_core::peer::MAX_LANES;
use gdp_core::secret_file::SecretFileError;
use gdp_e2e::keys::RingError;
use gdp_e2e::seal::SealError;
use gdp_link::link::{LinkError, RekeySchedule};
use gdp_link::port::LinkAddr;
use gdp_proto::control::{NameRole, Record, RecordKey, Refusal, RefusalCode, Request};
use gdp_util::unix_time::unix_seconds;

pub use crate::node::attachment::SETTLING;
pub use counters::{Meter, NodeCounters, PublisherCounters, SubscriptionCounters};
pub use ending::Ended;
pub use feedback::{Feedback, FrameError};
use gdp_core::link_target::LinkTarget;
pub use lane::{LinkState, LinkStatus};
pub use options::{Overflow, PublishOptions, Reliability, Rotation, SubscribeOptions, Wants};
pub use publisher::{Publisher, Unflushed};
pub use service_instances::Instance;
pub use services::{Call, Client, Server};
pub use subscription::Subscription;

/// How a node finds its switch.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    pub identity: Identity,
    /// One to [`MAX_LANES`], in the order in which they are wanted, each to a switch of the same
    /// domain. Everything goes by the first that is up, and what is to be
    /// [duplicated](PublishOptions::duplicate) by the next one as well.
    pub links: Vec<LinkConfig>,
    /// How long [`Node::connect`] keeps trying.
    pub connect_timeout: Duration,
    /// When the keys of data frames are replaced.
    pub rekey: RekeySchedule,
    /// A folder in which the node keeps the revocations that it hears of, made if it is not there;
    /// without one, it forgets them when it ends.
    pub state: Option<PathBuf>,
    /// What the node shows of its trust domain. With it, it takes switches of that domain only, and
    /// of those that the domain has issued a PeerCert to; without, any.
    pub papers: Option<Credentials>,
}

/// One of a node's links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LinkConfig {
    pub target: LinkTarget,
    /// The name that the switch must prove; without it, any switch at `target` is taken.
    pub switch: Option<Name>,
    /// Bytes a second that topics send by this link at most, of frames with their header; `None`:
    /// what the ways to their readers take.
    pub budget: Option<u64>,
}

impl From<LinkTarget> for LinkConfig {
    fn from(target: LinkTarget) -> Self {
        Self { target, switch: None, budget: None }
    }
}

impl NodeConfig {
    /// One link, to any switch at `link`, waited for 10 s.
    pub fn new(identity: Identity, link: LinkTarget) -> Self {
        let (connect_timeout, rekey) = (Duration::from_secs(10), RekeySchedule::default());
        Self { identity, links: vec![link.into()], connect_timeout, rekey, state: None, papers: None }
    }
}

/// Why a node could not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Domain(#[from] DomainError),
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
    #[error(transparent)]
    Keys(#[from] RingError),
    #[error("no server of {0:#} is attached at the moment; call again later")]
    NoServer(Name),
    #[error("{instance:#}, a server of {service:#}, is not attached at the moment; call again later, or another")]
    NoInstance { service: Name, instance: Name },
    #[error(
        "{instance:#}, a server of {service:#}, left before it replied; the request may have been carried out, so it is sent to no other"
    )]
    InstanceLeft { service: Name, instance: Name },
    #[error("{0} calls wait for their replies already; wait for some, or give some up")]
    TooManyCalls(usize),
    #[error("the switch answered another question: {0}")]
    Protocol(&'static str),
    #[error("a node has 1 to {MAX_LANES} links, not {0}")]
    Links(usize),
    #[error(transparent)]
    State(#[from] SecretFileError),
    #[error(transparent)]
    Unflushed(#[from] Unflushed),
    #[error("the node is closed")]
    Closed,
}

impl NodeError {
    /// Whether it is about this moment, and time may mend it; otherwise the same again meets with
    /// the same.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Link(LinkError::Io { .. } | LinkError::WrongPeer { .. }) => false,
            Self::Refused(refusal) => {
                matches!(refusal.code, RefusalCode::Unreachable | RefusalCode::Limit | RefusalCode::NotAttached)
            }
            Self::Link(_) | Self::NoAnswer { .. } | Self::NoAddress { .. } | Self::NoSwitch(_) => true,
            // Credentials may be renewed.
            Self::Domain(_) => true,
            Self::Detached(_) | Self::NoServer(_) | Self::NoInstance { .. } | Self::InstanceLeft { .. } => true,
            Self::TooManyCalls(_) | Self::Unflushed(_) => true,
            Self::NotASwitch(_) | Self::Cert(_) | Self::Seal(_) | Self::Already { .. } | Self::Keys(_) => false,
            Self::Protocol(_) | Self::Links(_) | Self::State(_) | Self::Closed => false,
        }
    }
}

/// What a node can state about a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stated {
    Published,
    Subscribed,
    Served,
    Called,
}

impl Stated {
    const ALL: [Self; 4] = [Self::Published, Self::Subscribed, Self::Served, Self::Called];

    fn role(self) -> NameRole {
        match self {
            Self::Published => NameRole::Publisher,
            Self::Subscribed => NameRole::Subscriber,
            Self::Served => NameRole::Server,
            Self::Called => NameRole::Caller,
        }
    }

    /// Whether it concerns what the node sends, which may go by any of its links: to the name, or
    /// to those who serve it.
    fn sends(self) -> bool {
        matches!(self, Self::Published | Self::Called)
    }

    fn of(role: NameRole) -> Self {
        match role {
            NameRole::Publisher => Self::Published,
            NameRole::Subscriber => Self::Subscribed,
            NameRole::Server => Self::Served,
            NameRole::Caller => Self::Called,
        }
    }
}

impl std::fmt::Display for Stated {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Published => "published",
            Self::Subscribed => "subscribed to",
            Self::Served => "served",
            Self::Called => "called",
        })
    }
}

/// An attached entity. Clones are the same node; it detaches when the last of them and of what it
/// handed out is dropped.
#[derive(Clone)]
pub struct Node(Arc<Handle>);

/// What keeps the node running.
struct Handle {
    state: Arc<State>,
    stop: watch::Sender<bool>,
    supervisor: Mutex<Option<JoinHandle<()>>>,
}

impl Node {
    /// Makes links to the switches and attaches by them; returns as soon as one is up. Call within
    /// a tokio runtime.
    pub async fn connect(config: NodeConfig) -> Result<Self, NodeError> {
        let NodeConfig { identity, links, connect_timeout, rekey, state, papers } = config;
        if !(1..=MAX_LANES).contains(&links.len()) {
            return Err(NodeError::Links(links.len()));
        }
        let home = Home::new(&identity, papers)?;
        let (commands, command_queue) = std::sync::mpsc::channel();
        let (events, event_queue) = mpsc::unbounded_channel();
        let revoked = Revoked::open(state.as_deref(), identity.name())?;
        let state = Arc::new(State::new(identity, home, &links, revoked, commands, events));
        let (send_path, feedback) = (state.send_path.clone(), state.feedback.clone());
        let receiver = Receiver { commands: command_queue, send_path, feedback };
        spawn("gdp-receive", move || receiver.run())?;

        // From here on, dropping the handle ends everything.
        let (stop, (first, mut came)) = (watch::Sender::new(false), mpsc::unbounded_channel());
        let all = supervisor::run(state.clone(), links, rekey, connect_timeout, event_queue, first, stop.subscribe());
        let handle = Handle { state, stop, supervisor: Mutex::new(Some(tokio::spawn(all))) };
        // Of several, one that waiting may mend, and of these the one of the first link.
        let rank = |lane: u8, error: &NodeError| (!error.may_pass(), lane);
        let mut failure: Option<(u8, NodeError)> = None;
        loop {
            match came.recv().await {
                Some((_, Ok(()))) => break,
                Some((lane, Err(error))) => {
                    let (new, old) = (rank(lane, &error), failure.as_ref().map(|(lane, error)| rank(*lane, error)));
                    if old.is_none_or(|old| new < old) {
                        failure = Some((lane, error));
                    }
                }
                None => return Err(failure.map_or(NodeError::Closed, |(_, error)| error)),
            }
        }
        let send_path = handle.state.send_path.clone();
        spawn("gdp-send", move || send_path.pump())?;
        Ok(Self(Arc::new(handle)))
    }

    /// Publishes a name: `proof` shows how it is derived, `ad_cert` that its owner allows it.
    pub async fn publish(
        &self,
        proof: NameProof,
        ad_cert: Issued<AdCert>,
        options: PublishOptions,
    ) -> Result<Publisher, NodeError> {
        let state = &self.0.state;
        let statement = Statement::Write { proof, ad_cert };
        let name = state.check(&statement)?;
        let publication = state.open(name, Stated::Published, statement, &options)?;
        // From here on, dropping the publisher ends the statement.
        let publisher = Publisher::new(self.0.clone(), publication.clone(), state.feedback.of(name));
        self.make_known(name, Stated::Published, Some(&publication)).await?;
        Ok(publisher)
    }

    /// Subscribes to a name: `grant` shows that its owner allows it.
    pub async fn subscribe(
        &self,
        proof: NameProof,
        grant: Grant,
        options: SubscribeOptions,
    ) -> Result<Subscription, NodeError> {
        let state = &self.0.state;
        let statement = Statement::Read { proof, grant };
        let name = state.check(&statement)?;
        let (queue, ending) = state.read(name, Stated::Subscribed, statement, options)?;
        let subscription = Subscription::new(self.0.clone(), queue, ending);
        self.make_known(name, Stated::Subscribed, None).await?;
        Ok(subscription)
    }

    /// Answers calls to a name, as one of those who serve it: `ad_cert` shows that its owner allows
    /// it. Requests and replies can be read by the one caller and the one server alone.
    pub async fn serve(&self, proof: NameProof, ad_cert: Issued<AdCert>) -> Result<Server, NodeError> {
        let state = &self.0.state;
        let statement = Statement::Write { proof, ad_cert };
        let name = state.check(&statement)?;
        let (desk, ending) = state.open_service(name, Stated::Served, statement)?;
        let server = Server::new(self.0.clone(), name, desk, ending);
        self.make_known(name, Stated::Served, None).await?;
        Ok(server)
    }

    /// Calls a name, each time the nearest that serves it: `grant` shows that its owner allows it.
    pub async fn client(&self, proof: NameProof, grant: Grant) -> Result<Client, NodeError> {
        let state = &self.0.state;
        let statement = Statement::Read { proof, grant };
        let name = state.check(&statement)?;
        let (_, ending) = state.open_service(name, Stated::Called, statement)?;
        let client = Client::new(self.0.clone(), name, ending);
        self.make_known(name, Stated::Called, None).await?;
        state.store_first_boxes(name).await?;
        Ok(client)
    }

    /// States something to the RIB, and has keys for what is sent stored there: so those who are
    /// there have them before the first message.
    async fn make_known(
        &self,
        name: Name,
        stated: Stated,
        publication: Option<&Arc<Publication>>,
    ) -> Result<(), NodeError> {
        let state = &self.0.state;
        let attachment = loop {
            let attachment = state.attached().await?;
            match state.state(&attachment, name, stated).await {
                // Another is the main one meanwhile.
                Err(NodeError::Detached(_)) => {}
                result => break result.map(|()| attachment)?,
            }
        };
        if let Some(publication) = publication {
            state.store_boxes(&attachment, publication).await;
        }
        Ok(())
    }

    /// Who publishes and reads the names with this prefix, as far as it verifies: as many as fit an
    /// answer, from the one behind `after` on; and whether there are more.
    pub async fn query(&self, prefix: NamePrefix, after: Option<RecordKey>) -> Result<(Vec<Record>, bool), NodeError> {
        let state = &self.0.state;
        let attachment = state.attached().await?;
        let (mut records, truncated) = state.query(&attachment, prefix.clone(), after).await?;
        records.retain(|record| {
            let verdict = record.verify(None, unix_seconds());
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

    /// The links, in the order in which they are wanted, how they are and what went by them.
    pub fn links(&self) -> Vec<LinkStatus> {
        self.0.state.send_path.links()
    }

    /// The switch the node is attached to at the moment, by its main link; `Err` says why there is
    /// none.
    pub fn switch(&self) -> Result<Name, NodeError> {
        self.0.state.attached_now().map(|attachment| attachment.link.peer().name)
    }

    /// What became of frames and messages so far.
    pub fn counters(&self) -> NodeCounters {
        self.0.state.send_path.node_counters()
    }

    /// The same at any time, from any task.
    pub fn meter(&self) -> Meter<NodeCounters> {
        let send_path = self.0.state.send_path.clone();
        Meter::new(move || send_path.node_counters())
    }

    /// Shows renewed papers from now on, also on the links there are. An error if they are not this
    /// node's, or a switch does not take them: then what was shown before counts there. Of no
    /// effect on a node that was made without.
    pub async fn renew_credentials(&self, papers: Credentials) -> Result<(), NodeError> {
        let (state, papers) = (&self.0.state, Arc::new(papers));
        state.home.renew(papers.clone())?;
        for lane in state.send_path.lanes() {
            if let Status::Up(attachment) = lane.status() {
                let request = Request::Papers(Box::new(Credentials::clone(&papers)));
                attachment.link.request(&request).await?.accepted()?;
            }
        }
        Ok(())
    }

    /// Detaches: the switch is told, and withdraws everything at once. Publishers and subscriptions
    /// are of no use after.
    pub async fn close(&self) {
        let publications: Vec<_> = self.0.state.publications.lock().values().cloned().collect();
        publications.iter().for_each(|publication| publication.finish(&self.0.state.send_path));
        self.0.stop.send_replace(true);
        let task = self.0.supervisor.lock().take();
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

fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> Result<(), LinkError> {
    let spawned = std::thread::Builder::new().name(name.into()).spawn(run);
    spawned.map(drop).map_err(|source| LinkError::Io { what: format!("thread {name}"), source })
}

#[cfg(test)]
#[path = "../tests/unit/node/mod.rs"]
mod tests;
