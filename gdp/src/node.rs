//! The SDK: a node is an entity that is attached to a switch and publishes and subscribes to names.
//!
//! A node has one or several links. It verifies the answers of the switch and its RIB itself. Only
//! certificates of a name's owner decide which entities may write it.

mod abort_on_drop;
mod attachment;
mod choice;
mod clock;
mod clock_check;
mod clock_differences;
mod command;
mod config;
mod counters;
mod dialler;
mod early_frames;
mod ending;
mod error;
mod feedback;
mod frame_size;
mod greeting;
mod handle;
mod home;
mod immediate_sender;
mod inbox;
mod ingress;
mod latched;
mod link_status;
mod link_tasks;
mod links;
mod message_batch;
mod network;
mod options;
mod outgoing_feedback;
mod pairs;
mod pause;
mod peer_updates;
mod publication;
mod publications;
mod publisher;
mod queue;
mod queue_state;
mod reading;
mod receiver;
mod registration;
mod request_queue;
mod requests;
mod revoked;
mod scheduler;
mod sealer;
mod send_path;
mod sender;
mod service;
mod service_instances;
mod services;
mod shared_entry;
mod sink;
mod stamps;
mod state;
mod statement;
mod subscription;
mod subscription_receiver;
mod supervisor;

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Instant;

use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::{mpsc, watch};

use self::command::Commands;
use self::handle::Handle;
use self::home::Home;
use self::links::Connection;
use self::publication::Publication;
use self::receiver::Receiver;
use self::revoked::Revoked;
use self::state::State;
use self::statement::Statement;
use gdp_core::cert::{AdCert, Issued, Reading as Grant};
use gdp_core::domain::{CredentialFiles, Credentials, DomainError};
use gdp_core::name::{NamePrefix, NameProof};
use gdp_core::peer::MAX_LANES;
use gdp_link::link::LinkError;
use gdp_proto::control::{Inspected, Inspection, Record, RecordKey, Request, Response};
use gdp_util::file_watch::FileSet;
use gdp_util::unix_time::unix_seconds;

pub use attachment::SETTLING;
pub use clock_differences::ClockDifference;
pub use config::{LinkConfig, NodeConfig};
pub use counters::{Meter, NodeCounters, PublisherCounters, SubscriptionCounters};
pub use ending::Ended;
pub use error::{NodeError, Unflushed};
pub use feedback::{Feedback, FrameError};
pub use immediate_sender::ImmediateSender;
pub use link_status::{LinkState, LinkStatus};
pub use options::{Overflow, PublishOptions, Reliability, Rotation, SubscribeOptions, Wants};
pub use publisher::Publisher;
pub use service_instances::Instance;
pub use services::{Call, Client, Server};
pub use sink::MessageSink;
pub use statement::Stated;
pub use subscription::Subscription;

/// An attached entity. Clones refer to the same node. The node detaches when the last clone and the
/// last handle that it returned are dropped.
#[derive(Clone)]
pub struct Node(Arc<Handle>);

impl Node {
    /// Makes links to the switches and attaches over them. Returns as soon as one link is up. Call
    /// within a tokio runtime.
    pub async fn connect(config: NodeConfig) -> Result<Self, NodeError> {
        let NodeConfig { identity, links, connect_timeout, rekey, state, credentials } = config;
        if !(1..=MAX_LANES).contains(&links.len()) {
            return Err(NodeError::Links(links.len()));
        }
        let home = Home::new(&identity, credentials)?;
        let (commands, command_queue, wake) = Commands::new()?;
        let (updates, update_queue) = mpsc::unbounded_channel();
        let revoked = Revoked::open(state.as_deref(), identity.name())?;
        let state = Arc::new(State::new(identity, home, &links, revoked, commands, updates));
        let (send_path, feedback) = (state.send_path.clone(), state.feedback.clone());
        let receiver = Receiver { commands: command_queue, wake, send_path, feedback };
        spawn("gdp-receive", move || receiver.run())?;

        // From here on, dropping the handle stops the node.
        let (stop, (first, mut results)) = (watch::Sender::new(false), mpsc::unbounded_channel());
        let all = supervisor::run(state.clone(), links, rekey, connect_timeout, update_queue, first, stop.subscribe());
        let handle = Handle { state, stop, supervisor: Mutex::new(Some(tokio::spawn(all))) };
        // Of several errors, returns one that a retry may resolve; among those, the one of the
        // first link.
        let rank = |lane: u8, error: &NodeError| (!error.may_pass(), lane);
        let mut failure: Option<(u8, NodeError)> = None;
        loop {
            match results.recv().await {
                Some((_, Ok(()))) => break,
                Some((lane, Err(error))) => {
                    let (new, old) = (rank(lane, &error), failure.as_ref().map(|(lane, error)| rank(*lane, error)));
                    if old.is_none_or(|old| new < old) {
                        failure = Some((lane, error));
                    }
                }
                None => {
                    let status = handle.state.send_path.links.status();
                    return Err(match failure {
                        Some((_, NodeError::Detached(_))) if status.len() > 1 => NodeError::unreachable(&status),
                        Some((_, error)) => error,
                        None => NodeError::Closed,
                    });
                }
            }
        }
        let send_path = handle.state.send_path.clone();
        spawn("gdp-send", move || send_path.pump())?;
        Ok(Self(Arc::new(handle)))
    }

    /// Publishes a name. `proof` proves the derivation of the name, `ad_cert` the permission of its
    /// owner.
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
        // From here on, dropping the publisher withdraws the statement.
        let publisher = Publisher::new(self.0.clone(), publication.clone(), state.feedback.of(name));
        self.make_known(name, Stated::Published, Some(&publication)).await?;
        Ok(publisher)
    }

    /// Subscribes to a name. `grant` proves the permission of its owner.
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

    /// Serves calls to a name, as one of its servers. `ad_cert` proves the permission of the name's
    /// owner. Only the caller and the server of a call can read its request and reply.
    pub async fn serve(&self, proof: NameProof, ad_cert: Issued<AdCert>) -> Result<Server, NodeError> {
        let state = &self.0.state;
        let statement = Statement::Write { proof, ad_cert };
        let name = state.check(&statement)?;
        let (requests, ending) = state.open_service(name, Stated::Served, statement)?;
        let server = Server::new(self.0.clone(), name, requests, ending);
        self.make_known(name, Stated::Served, None).await?;
        Ok(server)
    }

    /// Calls a name; each call goes to the nearest server. `grant` proves the permission of the
    /// name's owner.
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

    /// Sends a statement to the RIB and stores the key boxes of the publication there. Attached
    /// readers therefore have the keys before the first message.
    async fn make_known(
        &self,
        name: Name,
        stated: Stated,
        publication: Option<&Arc<Publication>>,
    ) -> Result<(), NodeError> {
        let state = &self.0.state;
        let attachment = loop {
            let attachment = state.send_path.links.attached().await?;
            match state.state(&attachment, name, stated).await {
                // Another link has become the main one.
                Err(NodeError::Detached(_)) => {}
                result => break result.map(|()| attachment)?,
            }
        };
        if let Some(publication) = publication {
            state.store_boxes(&attachment, publication).await;
        }
        Ok(())
    }

    /// Returns the publishers and readers of the names with this prefix, without records that do
    /// not verify. An answer starts after the record `after`. The flag is true if there are more
    /// records than fit one answer.
    pub async fn query(&self, prefix: NamePrefix, after: Option<RecordKey>) -> Result<(Vec<Record>, bool), NodeError> {
        let state = &self.0.state;
        let attachment = state.send_path.links.attached().await?;
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

    /// Asks the switch about this node's attachment, or about the path of a name to which the node
    /// may send.
    pub async fn inspect(&self, inspection: Inspection) -> Result<Inspected, NodeError> {
        let attachment = self.0.state.send_path.links.attached().await?;
        match attachment.link.request(&Request::Inspect(inspection)).await?.accepted()? {
            Response::Inspected(inspected) => Ok(inspected),
            _ => Err(NodeError::Protocol("to a question about the attachment")),
        }
    }

    /// Returns this entity's name.
    pub fn name(&self) -> Name {
        self.0.state.identity.name()
    }

    /// Returns a receiver that is notified when interfaces, addresses or routes of this machine
    /// change. The kernel may report one change several times.
    pub fn network_changes(&self) -> watch::Receiver<()> {
        self.0.state.network_changes.subscribe()
    }

    /// Returns the state and counters of the links, in order of preference.
    pub fn links(&self) -> Vec<LinkStatus> {
        self.0.state.send_path.links.status()
    }

    /// Returns the switch at the other end of the main link, or the reason why the node is
    /// detached.
    pub fn switch(&self) -> Result<Name, NodeError> {
        self.0.state.send_path.links.attached_now().map(|attachment| attachment.link.peer().name)
    }

    /// Returns the counterparts whose messages are refused, or who refuse those of this node, for
    /// clocks that differ. Those of the last minute.
    pub fn clock_differences(&self) -> Vec<ClockDifference> {
        self.0.state.send_path.clocks.all(Instant::now())
    }

    /// Returns the counters of frames and messages.
    pub fn counters(&self) -> NodeCounters {
        self.0.state.send_path.links.node_counters()
    }

    /// Returns a meter that reads the same counters at any time, from any task.
    pub fn meter(&self) -> Meter<NodeCounters> {
        let links = self.0.state.send_path.links.clone();
        Meter::new(move || links.node_counters())
    }

    /// Replaces the node's credentials, also on existing links. Has no effect on a node without
    /// credentials.
    ///
    /// # Errors
    ///
    /// Fails if the credentials belong to another node, or if a switch refuses them. A switch that
    /// refuses them continues to use the earlier ones.
    pub async fn renew_credentials(&self, credentials: Credentials) -> Result<(), NodeError> {
        let (state, credentials) = (&self.0.state, Arc::new(credentials));
        state.home.renew(credentials.clone())?;
        for lane in 0..state.send_path.links.slots().len() {
            if let Connection::Up(attachment) = state.send_path.links.connection(lane) {
                let request = Request::Credentials(Box::new(Credentials::clone(&credentials)));
                attachment.link.request(&request).await?.accepted()?;
            }
        }
        Ok(())
    }

    /// Returns when the node's membership in its domain ends, in Unix seconds, or why it is not
    /// valid. `None` for a node without a domain.
    pub fn member_until(&self) -> Option<Result<u64, DomainError>> {
        self.0.state.home.member_until()
    }

    /// Keeps the credentials equal to the files, forever, and presents new ones to the switches
    /// over the existing links. `watched` has the same files, and was created before the node's
    /// credentials were read. Errors are logged, and what was there goes on to count.
    pub async fn follow_credentials(&self, files: &CredentialFiles, mut watched: FileSet) -> Infallible {
        loop {
            watched.changed().await;
            let renewed = match files.load() {
                Ok(credentials) => self.renew_credentials(credentials).await.map_err(|error| error.to_string()),
                Err(error) => Err(error.to_string()),
            };
            match renewed {
                Ok(()) => tracing::info!("took a renewed membership"),
                Err(error) => {
                    tracing::error!("the renewed membership is not taken, what was there goes on to count: {error}")
                }
            }
        }
    }

    /// Detaches from the switch, which withdraws all routes of the node at once. Publishers and
    /// subscriptions cannot be used afterwards.
    pub async fn close(&self) {
        let send_path = &self.0.state.send_path;
        send_path.publications.all().iter().for_each(|publication| send_path.finish(publication));
        self.0.stop.send_replace(true);
        let task = self.0.supervisor.lock().take();
        if let Some(task) = task {
            let _ = task.await;
        }
    }
}

fn spawn(name: &str, run: impl FnOnce() + Send + 'static) -> Result<(), LinkError> {
    let spawned = std::thread::Builder::new().name(name.into()).spawn(run);
    spawned.map(drop).map_err(|source| LinkError::Io { what: format!("thread {name}"), source })
}

#[cfg(test)]
#[path = "../tests/unit/node/mod.rs"]
mod tests;
