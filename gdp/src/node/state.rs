//! The node's statements and their state, shared by the application's handles, the supervisor and
//! its tasks.
//!
//! Requests to the RIB are sent from here. The supervisor decides when.

use std::collections::HashMap;
use std::sync::Arc;

use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::{mpsc, watch};

use super::command::{Command, Commands, RibUpdate};
use super::config::LinkConfig;
use super::counters::Counters;
use super::ending::{Ended, Ending};
use super::error::NodeError;
use super::feedback::Feedbacks;
use super::home::Home;
use super::options::{PublishOptions, SubscribeOptions};
use super::publication::Publication;
use super::queue::Queue;
use super::queue_state::QueueState;
use super::reading::Reading;
use super::request_queue::{self, RequestQueue};
use super::revoked::Revoked;
use super::send_path::SendPath;
use super::service::{PendingReply, Service, Services};
use super::service_instances::ServiceInstances;
use super::statement::{Advertisement, Stated, Statement};
use super::subscription_receiver::SubscriptionReceiver;
use gdp_core::cert::{CertError, Revocation};
use gdp_core::identity::Identity;
use gdp_core::name::NameProof;
use gdp_e2e::seal::MessageId;
use gdp_proto::control::{NameRole, PathCosts};
use gdp_proto::peers::Counterparts;
use gdp_util::unix_time::unix_seconds;

/// Validity in seconds of certificates for the switch and of statements to the RIB. They are
/// renewed long before it ends.
pub const LIFETIME: u32 = 24 * 3600;

/// The state that the handles, the supervisor and its tasks share.
pub struct State {
    pub identity: Identity,
    pub home: Arc<Home>,
    pub counters: Arc<Counters>,
    pub feedback: Arc<Feedbacks>,
    pub send_path: Arc<SendPath>,
    pub readings: Mutex<HashMap<Name, Reading>>,
    /// The services that this node serves and calls.
    pub services: Mutex<Services>,
    /// The path costs that the switch of each lane reported last.
    pub costs: Mutex<Vec<Arc<PathCosts>>>,
    /// Calls that wait for their replies.
    pub calls: Mutex<HashMap<MessageId, PendingReply>>,
    /// Whether the node receives requests and replies.
    pub inbox_opened: Mutex<bool>,
    /// The endings of subscriptions.
    pub subscriptions: Mutex<HashMap<Name, Arc<Ending>>>,
    /// All current statements to the RIB. They are repeated after each reconnection.
    pub statements: Mutex<HashMap<(Name, Stated), Advertisement>>,
    /// The counterparts of each statement.
    pub counterparts: Mutex<HashMap<(Name, NameRole), Counterparts>>,
    /// The known revocations of names.
    pub revoked: Revoked,
    /// The highest serial used, once attached. Locked while a statement is in flight, to preserve
    /// the order of statements. Links other than the main one lock it for a limited time only.
    pub serial: tokio::sync::Mutex<Option<u64>>,
    pub commands: Commands,
    pub rib_updates: mpsc::UnboundedSender<RibUpdate>,
    /// Notified when interfaces, addresses or routes of this machine change.
    pub network_changes: watch::Sender<()>,
}

impl State {
    /// Creates the state of a node that is not attached.
    pub fn new(
        identity: Identity,
        home: Home,
        links: &[LinkConfig],
        revoked: Revoked,
        commands: Commands,
        rib_updates: mpsc::UnboundedSender<RibUpdate>,
    ) -> Self {
        let counters = Arc::<Counters>::default();
        let send_path = Arc::new(SendPath::new(&identity, counters.clone(), links));
        Self {
            feedback: Arc::new(Feedbacks::new(identity.name())),
            identity,
            home: Arc::new(home),
            counters,
            readings: Mutex::default(),
            services: Mutex::default(),
            costs: Mutex::new(vec![Arc::default(); links.len()]),
            calls: Mutex::default(),
            inbox_opened: Mutex::default(),
            subscriptions: Mutex::default(),
            statements: Mutex::default(),
            counterparts: Mutex::default(),
            revoked,
            serial: tokio::sync::Mutex::default(),
            commands,
            rib_updates,
            network_changes: watch::Sender::default(),
            send_path,
        }
    }

    /// Checks that this node's own right in a name is valid under a revocation of the name.
    pub fn check_own(&self, name: Name, role: NameRole, revocation: &Revocation) -> Result<(), CertError> {
        let (statements, own) = (self.statements.lock(), self.identity.name());
        let standing = statements.get(&(name, Stated::of(role)));
        standing.map_or(Ok(()), |it| it.statement.verify(own, Some(revocation), unix_seconds()).map(drop))
    }

    /// Verifies the right of a statement, and returns its name.
    pub fn check(&self, statement: &Statement) -> Result<Name, CertError> {
        let name = statement.proof().name()?;
        let revoked = self.revoked.of(&name);
        let revocation = revoked.as_ref().map(|(_, claims)| claims);
        statement.verify(self.identity.name(), revocation, unix_seconds()).map(|(name, _)| name)
    }

    /// Returns the statements whose right has expired, with the errors.
    pub fn expired(&self, now: u64) -> Vec<(Name, Stated, CertError)> {
        let (statements, own) = (self.statements.lock(), self.identity.name());
        let late = statements.iter().filter(|(_, standing)| !standing.over && standing.not_after < now);
        let error = |standing: &Advertisement| standing.statement.verify(own, None, now).err();
        late.filter_map(|((name, stated), standing)| Some((*name, *stated, error(standing)?))).collect()
    }

    /// Ends a statement after this node's right in a name has ended.
    pub fn end(&self, name: Name, role: NameRole, error: CertError) {
        match self.statements.lock().get_mut(&(name, Stated::of(role))) {
            Some(standing) if !standing.over => standing.over = true,
            _ => return,
        }
        tracing::warn!(%name, %error, "the right of this node as a {role} has ended");
        match role {
            NameRole::Publisher => {
                if let Some(publication) = self.send_path.publications.get(&name) {
                    publication.end(error.into());
                }
            }
            NameRole::Subscriber => {
                if let Some(ending) = self.subscriptions.lock().get(&name) {
                    ending.end(error.into());
                }
                self.commands.send(Command::Unsubscribe { name });
            }
            NameRole::Server | NameRole::Caller => {
                if let Some(service) = self.services.lock().get_mut(&(name, role)) {
                    service.end(error.into());
                }
            }
        }
    }

    /// Ends all handles because the node closes.
    pub fn close(&self) {
        self.send_path.publications.all().iter().for_each(|publication| publication.end(Ended::Closed));
        self.subscriptions.lock().values().for_each(|ending| ending.end(Ended::Closed));
        self.services.lock().values_mut().for_each(|service| service.end(Ended::Closed));
    }

    /// Replaces the right of a statement. The RIB receives it now, or over the next link. If the
    /// RIB refuses it, the old right stays in force.
    pub async fn renew(
        &self,
        name: Name,
        stated: Stated,
        renewed: impl FnOnce(NameProof) -> Statement,
    ) -> Result<(), NodeError> {
        let proof = self.statements.lock().get(&(name, stated)).map(|standing| *standing.statement.proof());
        let statement = renewed(proof.ok_or(NodeError::Closed)?);
        let revocation = {
            let known = self.counterparts.lock();
            known.get(&(name, stated.role())).and_then(|counterparts| counterparts.revocation().cloned())
        };
        let (_, not_after) = statement.verify(self.identity.name(), revocation.as_ref(), unix_seconds())?;
        let old = match self.statements.lock().get_mut(&(name, stated)) {
            Some(standing) if !standing.over => {
                let new = Advertisement { statement, not_after, duplicate: standing.duplicate, done: 0, over: false };
                std::mem::replace(standing, new)
            }
            _ => return Err(NodeError::Closed),
        };
        let stating = async { self.state(&*self.send_path.links.attached_now()?, name, stated).await };
        let result = stating.await;
        match result {
            Ok(()) => {
                self.restate();
                Ok(())
            }
            Err(error) if !error.may_pass() => {
                if let Some(standing) = self.statements.lock().get_mut(&(name, stated)) {
                    *standing = Advertisement { done: 0, over: standing.over, ..old };
                }
                self.restate();
                Err(error)
            }
            Err(error) => {
                tracing::debug!(%name, %error, "a renewed right is stated later");
                self.restate();
                Ok(())
            }
        }
    }

    /// Adds a statement of the application, unless it already exists. `register` installs the
    /// consumer of the RIB's answers. It runs before the supervisor's tasks can send the statement.
    pub fn begin(
        &self,
        name: Name,
        stated: Stated,
        statement: Statement,
        duplicate: bool,
        register: impl FnOnce(),
    ) -> Result<(), NodeError> {
        let (_, not_after) = statement.verify(self.identity.name(), None, unix_seconds())?;
        let mut counterparts = Counterparts::new(*statement.proof(), stated.role())?;
        self.revoked.of(&name).into_iter().for_each(|revocation| counterparts.recall(revocation));
        let (mut known, mut statements) = (self.counterparts.lock(), self.statements.lock());
        // Under the lock: `domain_revoked` handles later revocations.
        self.home.revocations().iter().for_each(|claims| drop(counterparts.domain_revoked(claims)));
        if statements.contains_key(&(name, stated)) {
            return Err(NodeError::Already { name, stated });
        }
        known.insert((name, stated.role()), counterparts);
        register();
        statements.insert((name, stated), Advertisement { statement, not_after, duplicate, done: 0, over: false });
        self.send_path.scheduler.double(name, is_doubled(&statements, &name));
        Ok(())
    }

    pub fn is_stated(&self, name: Name, stated: Stated) -> bool {
        self.statements.lock().contains_key(&(name, stated))
    }

    /// Starts to serve or call a service. Returns its ending, and for a server the queue of
    /// requests.
    pub fn open_service(
        self: &Arc<Self>,
        name: Name,
        stated: Stated,
        statement: Statement,
    ) -> Result<(RequestQueue, Arc<Ending>), NodeError> {
        self.open_inbox();
        let ((tray, requests), ending) = (request_queue::new(), Arc::<Ending>::default());
        let tray = (stated == Stated::Served).then_some(tray);
        let service = Service { instances: ServiceInstances::new(self.identity.name()), ending: ending.clone(), tray };
        let register = || _ = self.services.lock().insert((name, stated.role()), service);
        self.begin(name, stated, statement, false, register)?;
        Ok((requests, ending))
    }

    /// Opens a publication with its statement.
    pub fn open(
        &self,
        name: Name,
        stated: Stated,
        statement: Statement,
        options: &PublishOptions,
    ) -> Result<Arc<Publication>, NodeError> {
        let publication = Arc::new(self.publication(name, options)?);
        let insert = || self.send_path.publications.insert(publication.clone());
        self.begin(name, stated, statement, options.duplicate, insert).inspect_err(|_| publication.close())?;
        Ok(publication)
    }

    /// Creates a publication without registering it.
    pub fn publication(&self, name: Name, options: &PublishOptions) -> Result<Publication, NodeError> {
        Publication::new(name, &self.identity, options, &self.send_path.scheduler, &self.send_path.pairs)
    }

    /// Opens a subscription with its statement. Returns its queue and its ending.
    pub fn read(
        &self,
        name: Name,
        stated: Stated,
        statement: Statement,
        options: SubscribeOptions,
    ) -> Result<(Queue, Arc<Ending>), NodeError> {
        let mut listening = None;
        let duplicate = options.duplicate;
        self.begin(name, stated, statement, duplicate, || listening = Some(self.listen(name, options)))?;
        listening.ok_or(NodeError::Closed)
    }

    /// Starts to receive a name. Returns the queue of its messages and its ending.
    pub fn listen(&self, name: Name, options: SubscribeOptions) -> (Queue, Arc<Ending>) {
        let (sender, receiver) = mpsc::channel(options.queue.max(1));
        let (shared, ended) = (Arc::<QueueState>::default(), Arc::<Ending>::default());
        self.readings.lock().insert(name, Reading::new(name, &self.identity));
        self.subscriptions.lock().insert(name, ended.clone());
        let subscription = SubscriptionReceiver::new(name, options, sender, shared.clone());
        self.commands.send(Command::Subscribe { name, receiver: Box::new(subscription) });
        (Queue::new(name, receiver, shared, self.commands.clone()), ended)
    }

    /// Withdraws a statement after its handle was dropped. The supervisor informs the RIB, or the
    /// loss of the link does.
    pub fn withdraw(&self, name: Name, stated: Stated) {
        // The statement is removed last. Until then, no other handle can make the same statement.
        match stated {
            Stated::Served | Stated::Called => {
                let mut known = self.counterparts.lock();
                self.end_service(name, stated, Ended::Closed);
                known.remove(&(name, stated.role()));
            }
            Stated::Subscribed => {
                self.subscriptions.lock().remove(&name).into_iter().for_each(|ending| ending.end(Ended::Closed));
                if let Some(reading) = self.readings.lock().remove(&name) {
                    reading.writers().for_each(|writer| self.send_path.pairs.part(writer));
                }
                self.commands.send(Command::Unsubscribe { name });
            }
            Stated::Published => {
                self.feedback.forget(&name);
                self.send_path.close(&name);
            }
        }
        self.counterparts.lock().remove(&(name, stated.role()));
        {
            let mut statements = self.statements.lock();
            statements.remove(&(name, stated));
            self.send_path.scheduler.double(name, is_doubled(&statements, &name));
        }
        self.withdraw_later(name, stated);
    }

    /// Makes the supervisor send a withdrawal to the RIB when there is a link.
    pub fn withdraw_later(&self, name: Name, stated: Stated) {
        let _ = self.rib_updates.send(RibUpdate::Withdraw { name, stated });
    }
}

fn is_doubled(statements: &HashMap<(Name, Stated), Advertisement>, name: &Name) -> bool {
    Stated::ALL.iter().any(|stated| statements.get(&(*name, *stated)).is_some_and(|standing| standing.duplicate))
}
