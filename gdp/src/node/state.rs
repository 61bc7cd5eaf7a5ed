//! What a node states to the RIB, and the link it states it on: shared by the application's
//! handles, the supervisor and its tasks. Requests go out from here; when, is the supervisor's
//! business.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::mpsc;

use super::counters::Counters;
use super::ending::{Ended, Ending};
use super::feedback::Feedbacks;
use super::home::Home;
use super::inbox::{Service, Services};
use super::lane::{LinkSlot, Status};
use super::options::{PublishOptions, SubscribeOptions};
use super::publication::Publication;
use super::reading::Reading;
use super::receiver::Command;
use super::request_queue::{self, RequestQueue};
use super::revoked::Revoked;
use super::send_path::SendPath;
use super::service_instances::ServiceInstances;
use super::services::Pending;
use super::subscription::Queue;
use super::subscription_receiver::{Shared, SubscriptionReceiver};
use super::supervisor::Event;
use super::{LinkConfig, NodeError, Stated};
use crate::node::attachment::Attachment;
use gdp_core::cert::{
    AdCert, Advert, AdvertOp, CertError, Issued, Reading as Grant, Revocation, RtCert, Signed, issue,
};
use gdp_core::identity::Identity;
use gdp_core::name::{NamePrefix, NameProof};
use gdp_e2e::seal::MessageId;
use gdp_proto::control::{EntityRequest, NameRole, PathCosts, Record, RecordKey, RefusalCode, Request, Response};
use gdp_proto::peers::Counterparts;
use gdp_util::unix_time::unix_seconds;

/// Seconds that certificates for the switch and statements to the RIB hold; they are renewed long
/// before.
pub const LIFETIME: u32 = 24 * 3600;

/// How long a request waits for a link that is lost.
const LINK_PATIENCE: Duration = Duration::from_secs(10);

/// What the handles, the supervisor and its tasks share.
pub struct State {
    pub identity: Identity,
    pub home: Home,
    pub counters: Arc<Counters>,
    pub feedback: Arc<Feedbacks>,
    pub send_path: Arc<SendPath>,
    pub publications: Mutex<HashMap<Name, Arc<Publication>>>,
    pub readings: Mutex<HashMap<Name, Reading>>,
    /// What this node serves and calls.
    pub services: Mutex<Services>,
    /// What paths cost from the switch of each lane, as it last said.
    pub costs: Mutex<Vec<Arc<PathCosts>>>,
    /// Calls that wait for their replies.
    pub calls: Mutex<HashMap<MessageId, Pending>>,
    /// Whether requests and replies are taken.
    pub inbox_opened: Mutex<bool>,
    /// That subscriptions ended, and why.
    pub subscriptions: Mutex<HashMap<Name, Arc<Ending>>>,
    /// Everything the RIB is to know, stated again after each reconnection.
    statements: Mutex<HashMap<(Name, Stated), Advertisement>>,
    /// Those on the other side of what is stated.
    pub counterparts: Mutex<HashMap<(Name, NameRole), Counterparts>>,
    /// What owners have taken back, as far as it came by.
    pub revoked: Revoked,
    /// The highest serial used, once attached. Held while a statement is on its way, so that they
    /// arrive in their order; by links other than the main one for a moment only.
    serial: tokio::sync::Mutex<Option<u64>>,
    commands: std::sync::mpsc::Sender<Command>,
    pub events: mpsc::UnboundedSender<Event>,
}

/// The right to a name, as it is shown to the RIB.
#[derive(Clone, PartialEq, Eq)]
pub enum Statement {
    /// Publishes or serves.
    Write { proof: NameProof, ad_cert: Issued<AdCert> },
    /// Subscribes or calls.
    Read { proof: NameProof, grant: Grant },
}

/// A statement that the application wants to stand.
struct Advertisement {
    statement: Statement,
    /// When the right ends, in Unix seconds.
    not_after: u64,
    /// It comes and goes by two links.
    duplicate: bool,
    /// Lanes on whose present link it was stated, as a bit each.
    done: u8,
    /// The right has ended.
    over: bool,
}

impl Statement {
    /// The name it is about and when the right ends (Unix seconds), if it holds for this entity.
    fn verify(&self, entity: Name, revocation: Option<&Revocation>, now: u64) -> Result<(Name, u64), CertError> {
        match self {
            Self::Write { proof, ad_cert } => {
                let claims = ad_cert.verify(proof, revocation, now)?;
                if claims.entity != entity {
                    return Err(CertError::WrongEntity { expected: entity, got: claims.entity });
                }
                Ok((claims.name, claims.not_after))
            }
            Self::Read { proof, grant } => {
                let claims = grant.verify(proof, entity, revocation, now)?;
                Ok((claims.name, claims.not_after))
            }
        }
    }

    fn proof(&self) -> &NameProof {
        match self {
            Self::Write { proof, .. } | Self::Read { proof, .. } => proof,
        }
    }
}

impl State {
    /// Not attached yet.
    pub fn new(
        identity: Identity,
        home: Home,
        links: &[LinkConfig],
        revoked: Revoked,
        commands: std::sync::mpsc::Sender<Command>,
        events: mpsc::UnboundedSender<Event>,
    ) -> Self {
        let counters = Arc::<Counters>::default();
        Self {
            feedback: Arc::new(Feedbacks::new(identity.name())),
            send_path: Arc::new(SendPath::new(&identity, counters.clone(), links)),
            identity,
            home,
            counters,
            publications: Mutex::default(),
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
            events,
        }
    }

    /// Why there is still no link.
    pub fn still_lost(&self, lane: &LinkSlot, why: String) {
        self.send_path.change_status(lane, |status| {
            if let Status::Down(reason) | Status::Held(_, reason) = status {
                *reason = why;
            }
        });
    }

    /// The link that fell silent is of no use any more.
    pub fn end_hold(&self, lane: &LinkSlot) {
        self.send_path.change_status(lane, |status| {
            if let Status::Held(_, reason) = status {
                *status = Status::Down(std::mem::take(reason));
            }
        });
    }

    pub fn command(&self, command: Command) {
        // The thread ends only once this node is closed.
        let _ = self.commands.send(command);
        if let Ok(attachment) = self.send_path.sending_on() {
            attachment.data.wake();
        }
    }

    /// The main link, if it is up at this moment.
    pub fn attached_now(&self) -> Result<Arc<Attachment>, NodeError> {
        self.send_path.attached_now()
    }

    /// The main link, waiting for it a while.
    pub async fn attached(&self) -> Result<Arc<Attachment>, NodeError> {
        let mut ways = self.send_path.ways();
        let settled = ways.wait_for(|ways| !matches!(ways.status, Status::Down(_) | Status::Held(..)));
        let _ = tokio::time::timeout(LINK_PATIENCE, settled).await;
        self.attached_now()
    }

    /// Whether this node's own right in a name holds under a revocation of it.
    pub fn check_own(&self, name: Name, role: NameRole, revocation: &Revocation) -> Result<(), CertError> {
        let (statements, own) = (self.statements.lock(), self.identity.name());
        let standing = statements.get(&(name, Stated::of(role)));
        standing.map_or(Ok(()), |it| it.statement.verify(own, Some(revocation), unix_seconds()).map(drop))
    }

    /// The name that a right is about, if it holds.
    pub fn check(&self, statement: &Statement) -> Result<Name, CertError> {
        let name = statement.proof().name()?;
        let revoked = self.revoked.of(&name);
        let revocation = revoked.as_ref().map(|(_, claims)| claims);
        statement.verify(self.identity.name(), revocation, unix_seconds()).map(|(name, _)| name)
    }

    /// The statements whose right has ended by itself, and the errors that say so.
    pub fn expired(&self, now: u64) -> Vec<(Name, Stated, CertError)> {
        let (statements, own) = (self.statements.lock(), self.identity.name());
        let late = statements.iter().filter(|(_, standing)| !standing.over && standing.not_after < now);
        let error = |standing: &Advertisement| standing.statement.verify(own, None, now).err();
        late.filter_map(|((name, stated), standing)| Some((*name, *stated, error(standing)?))).collect()
    }

    /// This node's own right in a name has ended.
    pub fn end(&self, name: Name, role: NameRole, error: CertError) {
        match self.statements.lock().get_mut(&(name, Stated::of(role))) {
            Some(standing) if !standing.over => standing.over = true,
            _ => return,
        }
        tracing::warn!(%name, %error, "the right of this node as a {role} has ended");
        match role {
            NameRole::Publisher => {
                if let Some(publication) = self.publications.lock().get(&name) {
                    publication.end(error.into());
                }
            }
            NameRole::Subscriber => {
                if let Some(ending) = self.subscriptions.lock().get(&name) {
                    ending.end(error.into());
                }
                self.command(Command::Unsubscribe { name });
            }
            NameRole::Server | NameRole::Caller => {
                if let Some(service) = self.services.lock().get_mut(&(name, role)) {
                    service.end(error.into());
                }
            }
        }
    }

    /// The node is closed.
    pub fn close(&self) {
        self.publications.lock().values().for_each(|publication| publication.end(Ended::Closed));
        self.subscriptions.lock().values().for_each(|ending| ending.end(Ended::Closed));
        self.services.lock().values_mut().for_each(|service| service.end(Ended::Closed));
    }

    /// Puts another right in the place of the one that something is stated by. The RIB has it then,
    /// or gets it with the next link; if it refuses it, the old one stays.
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
        let stating = async { self.state(&*self.attached_now()?, name, stated).await };
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

    /// Takes in what the application states, unless it is stated already. `register` puts in place
    /// what the RIB's answer is for: it is called before anybody can state it, as the supervisor's
    /// tasks may do at once.
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
        // Under the lock: what comes from now on, `domain_revoked` tells.
        self.home.revocations().iter().for_each(|claims| drop(counterparts.domain_revoked(claims)));
        if statements.contains_key(&(name, stated)) {
            return Err(NodeError::Already { name, stated });
        }
        known.insert((name, stated.role()), counterparts);
        register();
        statements.insert((name, stated), Advertisement { statement, not_after, duplicate, done: 0, over: false });
        self.send_path.double(name, is_doubled(&statements, &name));
        Ok(())
    }

    pub fn is_stated(&self, name: Name, stated: Stated) -> bool {
        self.statements.lock().contains_key(&(name, stated))
    }

    /// Serves or calls what is stated: returns the end of that, and of what is served where
    /// requests come.
    pub fn open_service(
        self: &Arc<Self>,
        name: Name,
        stated: Stated,
        statement: Statement,
    ) -> Result<(RequestQueue, Arc<Ending>), NodeError> {
        self.open_inbox();
        let ((tray, desk), ending) = (request_queue::new(), Arc::<Ending>::default());
        let tray = (stated == Stated::Served).then_some(tray);
        let service = Service { parties: ServiceInstances::new(self.identity.name()), ending: ending.clone(), tray };
        let register = || _ = self.services.lock().insert((name, stated.role()), service);
        self.begin(name, stated, statement, false, register)?;
        Ok((desk, ending))
    }

    /// A publication for what is stated.
    pub fn open(
        &self,
        name: Name,
        stated: Stated,
        statement: Statement,
        options: &PublishOptions,
    ) -> Result<Arc<Publication>, NodeError> {
        let publication = Arc::new(Publication::new(name, &self.identity, options, &self.send_path)?);
        let begun = self.begin(name, stated, statement, options.duplicate, || self.register(publication.clone()));
        begun.inspect_err(|_| publication.close(&self.send_path))?;
        Ok(publication)
    }

    pub fn register(&self, publication: Arc<Publication>) {
        self.send_path.open(publication.clone());
        self.publications.lock().insert(publication.name, publication.clone());
        self.command(Command::Publish { publication });
    }

    pub fn unregister(&self, name: Name) {
        if let Some(publication) = self.publications.lock().remove(&name) {
            self.command(Command::Unpublish { name });
            self.send_path.close(&publication);
        }
    }

    /// What comes of what is stated, and why it ended.
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

    /// What comes for a name, and why it ended.
    pub fn listen(&self, name: Name, options: SubscribeOptions) -> (Queue, Arc<Ending>) {
        let (sender, receiver) = mpsc::channel(options.queue.max(1));
        let (shared, ended) = (Arc::<Shared>::default(), Arc::<Ending>::default());
        self.readings.lock().insert(name, Reading::new(name, &self.identity));
        self.subscriptions.lock().insert(name, ended.clone());
        let intake = SubscriptionReceiver::new(name, options, sender, shared.clone());
        self.command(Command::Subscribe { name, intake: Box::new(intake) });
        (Queue::new(name, receiver, shared), ended)
    }

    /// A handle was dropped. The RIB is told by the supervisor, or by the loss of the link.
    pub fn withdraw(&self, name: Name, stated: Stated) {
        // The statement last: until then nobody else can begin the same.
        match stated {
            Stated::Served | Stated::Called => {
                let mut known = self.counterparts.lock();
                self.end_service(name, stated, Ended::Closed);
                known.remove(&(name, stated.role()));
            }
            Stated::Subscribed => {
                self.subscriptions.lock().remove(&name).into_iter().for_each(|ending| ending.end(Ended::Closed));
                if let Some(reading) = self.readings.lock().remove(&name) {
                    let mut pairs = self.send_path.pairs.lock();
                    reading.writers().for_each(|writer| pairs.part(writer));
                }
                self.command(Command::Unsubscribe { name });
            }
            Stated::Published => {
                self.feedback.forget(&name);
                self.unregister(name);
            }
        }
        self.counterparts.lock().remove(&(name, stated.role()));
        {
            let mut statements = self.statements.lock();
            statements.remove(&(name, stated));
            self.send_path.double(name, is_doubled(&statements, &name));
        }
        self.withdraw_later(name, stated);
    }

    /// Has the supervisor tell the RIB that this is withdrawn, once there is a link.
    pub fn withdraw_later(&self, name: Name, stated: Stated) {
        let _ = self.events.send(Event::Withdraw { name, stated });
    }

    /// Lets the switch carry this entity's traffic, and learns the serial that the next statement
    /// must exceed.
    pub async fn attach(&self, attachment: &Attachment) -> Result<(), NodeError> {
        let mut serial = self.serial.lock().await;
        self.attach_locked(attachment, &mut serial).await?;
        self.publications.lock().values().for_each(|publication| publication.store_again());
        self.statements.lock().values_mut().for_each(|standing| standing.done &= !bit(attachment));
        Ok(())
    }

    async fn attach_locked(&self, attachment: &Attachment, serial: &mut Option<u64>) -> Result<(), NodeError> {
        let switch = attachment.link.peer().name;
        let not_after = unix_seconds() + u64::from(LIFETIME);
        let rt_cert = issue(self.identity.key(), &RtCert { entity: self.identity.name(), switch, not_after })?;
        // A node that has spoken before goes on; one that has just started does not know what
        // another process had stated.
        let (resumes, lane) = (serial.is_some(), attachment.lane);
        match self.ask_in_turn(attachment, EntityRequest::Attach { rt_cert, resumes, lane }).await? {
            Response::Attached { serial: floor } => *serial = Some(floor.max(serial.unwrap_or(0))),
            _ => return Err(NodeError::Protocol("to an attachment")),
        }
        Ok(())
    }

    /// States one thing that stands to the RIB, if it belongs on this link and unless that is done
    /// since the last [`Self::attach`].
    ///
    /// What is sent may be sent by any link, whichever is the main one then. What is taken comes by
    /// the main one, and moves with it, unless it is to come by each.
    pub async fn state(&self, attachment: &Attachment, name: Name, stated: Stated) -> Result<(), NodeError> {
        if stated == Stated::Called {
            attachment.watch_costs(self).await;
        }
        let mut serial = self.serial.lock().await;
        let several = self.send_path.lanes().len() > 1;
        let (statement, everywhere) = {
            let mut statements = self.statements.lock();
            let Some(standing) = statements.get_mut(&(name, stated)) else { return Ok(()) };
            let everywhere = several && (stated.sends() || standing.duplicate);
            let belongs = everywhere || self.send_path.ways().borrow().main == usize::from(attachment.lane);
            if !belongs || standing.over || standing.done & bit(attachment) != 0 {
                return Ok(());
            }
            if !everywhere {
                // From here on it may stand by this link alone, whether or not the answer comes.
                standing.done = 0;
            }
            (standing.statement.clone(), everywhere)
        };
        let op = stated.role().op();
        let response = self.ask_signed(attachment, &mut serial, op, name, |advert| match statement.clone() {
            Statement::Write { proof, ad_cert } => EntityRequest::Advertise { proof, ad_cert, advert, everywhere },
            Statement::Read { proof, grant } => EntityRequest::Subscribe { proof, grant, advert, everywhere },
        });
        let Response::Peers(peers) = response.await? else { return Err(NodeError::Protocol("to a statement")) };
        // Something newer may have come before; then the RIB tells the whole once more.
        let _ = self.take_peers(name, stated.role(), &peers);
        // Unless another was put in its place meanwhile.
        if let Some(standing) = self.statements.lock().get_mut(&(name, stated)).filter(|it| it.statement == statement) {
            standing.done = if everywhere { standing.done | bit(attachment) } else { bit(attachment) };
        }
        if let Some(publication) = self.publications.lock().get(&name).filter(|_| stated == Stated::Published) {
            publication.stated();
        }
        if everywhere {
            self.restate();
        }
        self.send_path.upkeep.notify_one();
        Ok(())
    }

    /// States everything that stands; `false` if something was refused or did not get through, and
    /// should be tried again.
    pub async fn state_all(&self, attachment: &Attachment) -> bool {
        let standing: Vec<_> = self.statements.lock().keys().copied().collect();
        let mut all = true;
        for (name, stated) in standing {
            if let Err(error) = self.state(attachment, name, stated).await {
                tracing::warn!(%name, %error, "could not be {stated} again");
                all = false;
                // The rest would wait in vain as well, and others for it.
                if matches!(error, NodeError::Link(_) | NodeError::Detached(_)) {
                    break;
                }
            }
        }
        all
    }

    /// Withdraws a name. What else stands about it goes with it, and is to be stated again.
    pub async fn state_withdrawal(&self, attachment: &Attachment, name: Name, stated: Stated) -> Result<(), NodeError> {
        let mut serial = self.serial.lock().await;
        if self.statements.lock().contains_key(&(name, stated)) {
            return Ok(());
        }
        let request = |advert| EntityRequest::Withdraw { advert };
        self.ask_signed(attachment, &mut serial, AdvertOp::Withdraw, name, request).await?;
        for other in Stated::ALL {
            if let Some(standing) = self.statements.lock().get_mut(&(name, other)) {
                standing.done = 0;
                self.restate();
                // Its keys went with it.
                if let Some(publication) = self.publications.lock().get(&name).filter(|_| other == Stated::Published) {
                    publication.store_again();
                }
            }
        }
        Ok(())
    }

    /// There may be something to state on any link.
    pub fn restate(&self) {
        self.send_path.lanes().iter().for_each(|lane| lane.unstated.notify_one());
    }

    /// The records of the names that begin so, from the one behind `after` on, and whether there
    /// are more.
    pub async fn query(
        &self,
        attachment: &Attachment,
        prefix: NamePrefix,
        after: Option<RecordKey>,
    ) -> Result<(Vec<Record>, bool), NodeError> {
        match ask(attachment, EntityRequest::Query { prefix, after }).await? {
            Response::Records { records, truncated } => Ok((records, truncated)),
            _ => Err(NodeError::Protocol("to a query")),
        }
    }

    /// Gives the RIB a revocation that it does not know.
    pub async fn pass_on(
        &self,
        attachment: &Attachment,
        proof: NameProof,
        revocation: Signed<Revocation>,
    ) -> Result<(), NodeError> {
        ask(attachment, EntityRequest::Revoke { proof, revocation }).await.map(drop)
    }

    /// Asks with a statement of this entity, under the next serial; and once more under a higher
    /// one if something else spoke for the entity since it attached, such as a command-line tool.
    async fn ask_signed(
        &self,
        attachment: &Attachment,
        serial: &mut Option<u64>,
        op: AdvertOp,
        name: Name,
        request: impl Fn(Signed<Advert>) -> EntityRequest,
    ) -> Result<Response, NodeError> {
        match self.ask_in_turn(attachment, request(self.advert(attachment, op, name, serial)?)).await {
            Err(NodeError::Refused(refusal)) if refusal.code == RefusalCode::ReplayedSerial => {
                self.attach_locked(attachment, serial).await?;
                self.ask_in_turn(attachment, request(self.advert(attachment, op, name, serial)?)).await
            }
            result => result,
        }
    }

    /// As [`ask`], while all that is to be stated on any link waits for the answer: not for long if
    /// another link is the main one.
    async fn ask_in_turn(&self, attachment: &Attachment, request: EntityRequest) -> Result<Response, NodeError> {
        tokio::select! {
            answer = ask(attachment, request) => answer,
            () = self.send_path.until_unwanted(attachment) => Err(NodeError::Detached("another link is used".into())),
        }
    }

    fn advert(
        &self,
        attachment: &Attachment,
        op: AdvertOp,
        name: Name,
        highest: &mut Option<u64>,
    ) -> Result<Signed<Advert>, NodeError> {
        let serial = highest.unwrap_or(0).saturating_add(1);
        *highest = Some(serial);
        let (entity, switch) = (self.identity.name(), attachment.link.peer().name);
        let (lifetime, box_key) = (LIFETIME, self.identity.box_public());
        Ok(issue(self.identity.key(), &Advert { op, name, entity, switch, serial, lifetime, box_key })?)
    }
}

fn is_doubled(statements: &HashMap<(Name, Stated), Advertisement>, name: &Name) -> bool {
    Stated::ALL.iter().any(|stated| statements.get(&(*name, *stated)).is_some_and(|standing| standing.duplicate))
}

/// Of the lane in [`Advertisement::done`].
fn bit(attachment: &Attachment) -> u8 {
    1 << attachment.lane
}

pub async fn ask(attachment: &Attachment, request: EntityRequest) -> Result<Response, NodeError> {
    Ok(attachment.link.request(&Request::Entity(request)).await?.accepted()?)
}
