//! What the daemon holds and decides: its links, the RIB or the way to it, the topology, the FIB in
//! links, the data planes. Behind one lock, never held across an await; the tasks around it
//! ([`super::links`], [`super::report`], [`super::ports`], [`super::admin`]) do the waiting.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;

use gdp_core::cert::{Advert, Host};
use gdp_core::crypto;
use gdp_core::identity::Identity;
use gdp_core::name::NameProof;
use gdp_core::peer::{GRACEFUL_RESTART_TIME, Peer, Role};
use gdp_link::link::{KeyedEntry, Link, LinkIds, LinkKeys};
use gdp_link::port::LinkAddr;
use gdp_proto::control::{EntityRequest, FibPush, NameRole, Refusal, RefusalCode, Request, Response, TierResponse};
use gdp_wire::table::{EGRESS_SET_SIZE, MAX_LINKS, PORT_USERSPACE};
use gdp_wire::{LinkEntry, LinkRole, Name};
use tokio::sync::{oneshot, watch};

use super::control::{self, Report};
use super::crossing::Tracing;
use super::events::{Event, Events};
use super::federation::Federation;
use super::fence::Fence;
use super::graceful_restart::{GRACE, GracefulRestart, Kept, StaleLink};
use super::peering::Wanted;
use super::refusals::Refusals;
use super::routes::{Change, Routes};
use super::term::{Term, Ticket};
use super::trace::Outstanding;
use crate::config::{Inside, Neighbour, Via};
use crate::domain::{Admission, Credentials, Domain, Relationship};
use gdp_dataplane::{PlaneError, PlaneRoute, Planes};
use gdp_rib::crossing::Allowance;
use gdp_rib::rib::fib::Pushed;
use gdp_rib::rib::{Effect, Limits, Now, Rib, Run, UpdateId};
use gdp_rib::tiers::Sent;
use gdp_rib::topology::Topology;
use gdp_rib::topology::cost::Meter;
use gdp_util::unix_time::{unix_nanos, unix_seconds};

/// Routes that are tried in vain whenever there may be room: one may need what another does not.
const MAX_REFUSALS: usize = 16;

/// Those of a run's number that are random. The others hold the revisions of etcd for a lifetime,
/// and the time in units of 17 ms.
const RUN_BITS: u32 = 24;

/// Links of endpoints. Anybody can make one, so some are left for switches.
const MAX_ENDPOINTS: usize = (MAX_LINKS - EGRESS_SET_SIZE) as usize;

/// Switches that have links without being listed.
const MAX_UNLISTED: usize = EGRESS_SET_SIZE as usize;

/// The daemon's state.
pub struct Core {
    pub identity: Identity,
    pub neighbours: Vec<Neighbour>,
    pub rib: Option<Rib>,
    /// Of the RIB here, if that is the leader of several replicas.
    pub(super) term: Option<Arc<Term>>,
    /// Why a replica has no RIB, as far as it knows.
    pub(super) no_rib: Option<String>,
    /// Invitations that have admitted somebody, which is not stored yet.
    pub(super) unstored_invitations: BTreeSet<u64>,
    /// Without it, links are taken with all neighbours that are listed, and with all endpoints.
    pub domain: Option<Domain>,
    pub planes: Planes,
    pub routes: Routes,
    pub links: HashMap<u32, LinkState>,
    /// Links that the data planes hold besides.
    pub held: GracefulRestart,
    /// The link to each peer; to an endpoint, of each lane.
    pub peers: BTreeMap<(Name, u8), u32>,
    /// Endpoints that the RIB has attached here.
    pub attached: HashSet<Name>,
    /// Whether the RIB knows.
    pub report: Report,
    /// Of several that say they are the RIB, whose word counts.
    pub fence: Fence,
    pub topology: Topology,
    /// If the RIB is here, and this is a member of a domain.
    pub federation: Option<Federation>,
    /// The addresses at which other domains reach this border.
    pub public: Vec<SocketAddr>,
    /// What other domains see that trace names through this one.
    pub shown_inside: Inside,
    /// What the RIB may show of this switch, as of the membership in it.
    pub(super) shown: Option<Host>,
    /// The links into other domains that the RIB wants this switch to have.
    pub(super) peerings: watch::Sender<Wanted>,
    /// What the links to neighbours cost, of which the configuration does not say it.
    pub(super) meters: BTreeMap<Name, Meter>,
    /// Why peers have no link.
    pub refusals: Refusals,
    pub events: Events,
    /// Who waits for answers to probes.
    pub(super) outstanding: Outstanding,
    /// What was told last of the RIB here: names and switches.
    told_of_rib: (usize, usize),
    /// Interfaces without a carrier, by index.
    pub(super) dark: BTreeSet<u32>,
    /// Routes that the data plane refused, and why it refused the last.
    unplaced: (BTreeMap<Name, PlaneRoute>, String),
    /// Until when the data planes keep the ports and programs that an earlier daemon left.
    adopted_until: Option<Instant>,
    start: Instant,
}

/// A link that is up.
pub struct LinkState {
    pub link: Link,
    pub via: Via,
    pub since: Instant,
    /// What the peer is to this switch's domain, and until when.
    pub admission: Admission,
    /// Traces that the other end asks for, if it is of another domain.
    pub traces: Allowance,
    entry: KeyedEntry,
    pub(super) to: LinkAddr,
}

impl LinkState {
    /// What the data planes hold the peer for.
    pub fn role(&self) -> u32 {
        self.entry.role
    }
}

/// Something that the RIB here has to say, and the first link of the way, if there is one.
pub struct Outgoing {
    pub link: Option<Link>,
    pub request: Request,
    pub expects: Expects,
}

/// What the RIB here wants to know of the answer.
pub enum Expects {
    Nothing,
    /// What became of its push of this generation to this switch.
    Push(Name, u64),
    /// Whether an entity has been told of its counterparts.
    UpdateId(UpdateId),
    /// What another domain's RIB answers.
    Tier(Name, Sent),
    /// Whether a border has heard which peerings are wanted of it.
    Peerings(Name),
    /// That the endpoint has attached again; if not, its link is closed.
    Reattach,
}

/// What an entity has stated: what it is to the name, at a switch.
pub struct Statement {
    pub name: Name,
    entity: Name,
    role: NameRole,
    switch: Name,
}

impl Statement {
    pub fn is_settled(&self, rib: &Rib) -> bool {
        rib.is_settled(&self.name, &self.entity, self.role)
    }

    pub fn check_room(&self, rib: &mut Rib) -> Result<(), Refusal> {
        rib.check_room(&self.name, &self.entity, self.role, &self.switch)
    }
}

/// What a request needs before it can be answered.
pub enum Next {
    Answer(Response),
    /// The RIB here has accepted the statement; switches are still to be given the routes that
    /// follow.
    Settle(Response, Statement),
    /// The RIB here has taken a revocation in; it is to be kept before that is said.
    Keep(Response),
    /// The RIB here admits somebody by an invitation; likewise. `new`: its serial, if it had
    /// admitted nobody before.
    KeepInvitation {
        new: Option<u64>,
    },
    /// Another domain's RIB is asked; what it answers is for a RIB, or for whoever made the query.
    Await {
        waiting: oneshot::Receiver<TierResponse>,
        is_query: bool,
    },
    /// The name is traced on.
    Trace(Box<Tracing>),
    /// What the RIB here has taken in is to be stored before anything else.
    Store(Ticket, Box<Next>),
    /// The RIB has asked this switch to report again.
    Report,
    /// Ask over this link, and pass the response on.
    Forward(Link, Request),
    /// Have the endpoint at the other end of these attach again by each, or close it.
    Reattach(Vec<Link>, Request),
}

impl Core {
    pub fn new(identity: Identity, neighbours: Vec<Neighbour>, rib: bool, planes: Planes) -> Self {
        let start = unix_nanos();
        let run = Run { id: run_id(start >> RUN_BITS), settling: GRACEFUL_RESTART_TIME };
        let rib = rib.then(|| Rib::new(identity.name(), run, Limits::default()));
        let mut topology = Topology::new(identity.clone(), start);
        topology.set_rib(rib.is_some());
        Self {
            identity,
            neighbours,
            rib,
            term: None,
            no_rib: None,
            unstored_invitations: BTreeSet::new(),
            domain: None,
            planes,
            routes: Routes::default(),
            links: HashMap::new(),
            held: GracefulRestart::default(),
            peers: BTreeMap::new(),
            attached: HashSet::new(),
            report: Report::default(),
            fence: Fence::default(),
            topology,
            federation: None,
            public: Vec::new(),
            shown_inside: Inside::default(),
            shown: None,
            peerings: watch::Sender::default(),
            meters: BTreeMap::new(),
            refusals: Refusals::default(),
            events: Events::default(),
            outstanding: Outstanding::default(),
            told_of_rib: (0, 0),
            dark: BTreeSet::new(),
            unplaced: Default::default(),
            adopted_until: None,
            start: Instant::now(),
        }
    }

    pub fn name(&self) -> Name {
        self.identity.name()
    }

    /// Keeps what an earlier daemon left in the data planes, until peers and RIB have replaced it,
    /// for a while. The endpoints it had links with count as attached: they attach again when they
    /// notice.
    pub fn take_over(&mut self, ids: &LinkIds) {
        let Some(left) = self.planes.left().cloned() else { return };
        let until = Instant::now() + GRACEFUL_RESTART_TIME;
        let mut links = Vec::new();
        for (entry, to) in &left.links {
            let (Some(role), Some(id)) = (entry.role(), ids.reserve(entry.id)) else { continue };
            let id = Kept::Adopted { _id: id };
            links.push((entry.clone(), role));
            let (peer, lane) = (entry.peer, entry.lane as u8);
            let (entry, standing) = (entry.clone(), None);
            self.held.keep(StaleLink { peer, lane, role, entry, to: *to, until, standing, id });
            match role {
                LinkRole::Endpoint => drop(self.attached.insert(peer)),
                LinkRole::Switch | LinkRole::Border => {
                    drop(self.meters.insert(peer, Meter::new(self.now().clock, None)))
                }
            }
        }
        let changes = self.routes.adopt(&left, &links);
        self.carry_out(changes);
        self.adopted_until = Some(until);
        let routes = left.routes.len();
        tracing::info!(
            links = links.len(),
            routes,
            "took over from a daemon that ended without being stopped; its links are held"
        );
    }

    /// Removes what is held and whose time is over. Returns endpoints that are no longer attached,
    /// and whether neighbours are gone.
    pub fn end_hold(&mut self, now: Instant) -> (Vec<Name>, bool) {
        let adjacent = self.adjacencies();
        let lost = self.held.over(now).into_iter().filter_map(|id| self.release(id)).collect();
        if self.adopted_until.take_if(|until| *until <= now).is_some() {
            tracing::info!("nothing is held any longer from the daemon before this one");
            let mut changes = self.routes.end_any_writer();
            changes.extend(self.routes.end_held_paths());
            self.carry_out(changes);
            if let Err(error) = self.planes.end_adoption() {
                tracing::error!(%error, "the data plane keeps something of the daemon before this one");
            }
        }
        (lost, self.adjacencies() != adjacent)
    }

    /// Removes a link that is held, because its time is over or nothing forwards at its other end.
    /// Returns its peer, if that is an endpoint that is no longer attached for it.
    pub fn release(&mut self, id: u32) -> Option<Name> {
        let StaleLink { peer, role, .. } = self.held.take(id)?;
        self.remove_link(role, peer, id);
        let gone = role == LinkRole::Endpoint && !self.has_link(&peer) && !self.held.keeps(&peer);
        (gone && self.attached.contains(&peer)).then_some(peer)
    }

    pub fn now(&self) -> Now {
        Now { unix: unix_seconds(), clock: self.start.elapsed() }
    }

    /// The moment at which [`Now::clock`] will be `clock`; none for one so far off that no
    /// certificate should name it.
    pub fn instant(&self, clock: std::time::Duration) -> Option<Instant> {
        self.start.checked_add(clock)
    }

    /// Whether a peer may have a link where it came in, and as what; if not, why.
    pub fn admit(&self, link: &Link, via: &Via) -> Result<Admission, String> {
        let peer = link.peer();
        if peer.name == self.name() {
            return Err(format!("the peer has the key of this switch, {}: give each a key of its own", peer.name));
        }
        let admission = match &self.domain {
            Some(domain) => {
                let admitted = domain.trust.admit(Role::Switch, peer, link.papers().as_deref(), unix_seconds());
                admitted.map_err(|error| error.to_string())?
            }
            None => Admission::STRANGER,
        };
        match peer.role {
            Role::Endpoint => self.check_room()?,
            Role::Switch => self.check_place(peer, via)?,
        }
        Ok(admission)
    }

    fn check_room(&self) -> Result<(), String> {
        let live = self.links.values().filter(|state| state.link.peer().role == Role::Endpoint).count();
        let held = self.held.iter().filter(|held| held.role == LinkRole::Endpoint).count();
        if live + held < MAX_ENDPOINTS {
            return Ok(());
        }
        Err(format!("{MAX_ENDPOINTS} endpoints have links to this switch, the most it takes"))
    }

    /// A neighbour that is listed has its place. Any other must have been admitted by a domain.
    fn check_place(&self, peer: &Peer, via: &Via) -> Result<(), String> {
        let switch = peer.name;
        match self.neighbours.iter().find(|n| n.place.switch == switch) {
            Some(neighbour) if neighbour.place.via.same_port(via) => Ok(()),
            Some(_) => Err(format!("switch {switch} is a neighbour elsewhere, not {via}")),
            None if self.domain.is_none() => {
                Err(format!("switch {switch} is not listed in the neighbours of this one"))
            }
            None => {
                let unlisted = |name: &Name| self.neighbours.iter().all(|n| n.place.switch != *name);
                let live = self.links.values().map(|state| state.link.peer());
                let others: BTreeSet<Name> = live
                    .filter(|p| p.role == Role::Switch && p.name != switch)
                    .map(|p| p.name)
                    .filter(unlisted)
                    .collect();
                if others.len() < MAX_UNLISTED {
                    return Ok(());
                }
                Err(format!("{MAX_UNLISTED} switches that are not listed in the neighbours have links to this one"))
            }
        }
    }

    /// What the RIB is to be asked before a member that was admitted by an invitation is taken for
    /// one. A neighbour that the configuration names is taken if there is no way to the RIB but by
    /// it: there is nobody else to ask.
    pub fn question(&self, link: &Link, papers: &Credentials) -> Option<Request> {
        let domain = self.domain.as_ref()?;
        let entity = link.peer().name;
        let invite = papers.membership.invite_unverified().ok()??;
        let is_own = papers.membership.domain.name().is_ok_and(|name| name == domain.trust.home());
        let is_known = domain.invitations.has_admitted(invite.serial, &entity);
        if !is_own || is_known || self.is_only_way_to_rib(&entity) {
            return None;
        }
        Some(Request::Admitted { switch: self.name(), entity, membership: Box::new(papers.membership.clone()) })
    }

    fn is_only_way_to_rib(&self, neighbour: &Name) -> bool {
        let paths = self.topology.paths();
        let is_listed = self.neighbours.iter().any(|n| n.place.switch == *neighbour);
        let other_way = |(rib, _): &(Name, u64)| paths.next.get(rib).is_some_and(|next| next != neighbour);
        self.rib.is_none() && is_listed && !paths.rib.as_ref().is_some_and(other_way)
    }

    /// The peer of a link shows other papers: whether it may keep the link by them.
    pub fn renew_link(&mut self, link: &Link, papers: &Credentials) -> Result<(), String> {
        let Some(domain) = &self.domain else { return Ok(()) };
        let admitted = domain.trust.admit(Role::Switch, link.peer(), Some(papers), unix_seconds());
        let admission = admitted.map_err(|error| error.to_string())?;
        let Some(state) = self.links.get_mut(&link.local_id()) else { return Ok(()) };
        if admission.standing.as_str() != state.admission.standing.as_str() {
            let (was, is) = (state.admission.standing.as_str(), admission.standing.as_str());
            return Err(format!("the peer was taken as {was} and is {is} now: make the link anew"));
        }
        let is_other = flags_of(&admission) != state.entry.flags;
        state.admission = admission;
        if is_other {
            self.put_flags(link.local_id());
        }
        Ok(())
    }

    /// Writes what the peer's domain may do to the data planes.
    fn put_flags(&mut self, id: u32) {
        let Some(state) = self.links.get_mut(&id) else { return };
        state.entry.flags = flags_of(&state.admission);
        if let Err(error) = self.planes.set_link(*state.entry, state.to) {
            tracing::error!(link = id, %error, "the data plane did not take what the domain of a peer may do now");
        }
    }

    /// Judges links anew, all or only those whose time has come. Returns those to be closed, with
    /// the reason, and endpoints whose last link was one that is held.
    pub fn recheck(&mut self, now: u64, only_ended: bool) -> (Vec<(Link, String)>, Vec<Name>) {
        let Some(domain) = &self.domain else { return Default::default() };
        let judge = |link: &Link| domain.trust.admit(Role::Switch, link.peer(), link.papers().as_deref(), now);
        let (mut refused, mut changed) = (Vec::new(), Vec::new());
        let is_due = |state: &&mut LinkState| !only_ended || state.admission.until < now;
        for state in self.links.values_mut().filter(is_due).filter(|state| state.link.close_reason().is_none()) {
            match judge(&state.link) {
                Ok(admission) if admission.standing.as_str() == state.admission.standing.as_str() => {
                    changed.extend((flags_of(&admission) != state.entry.flags).then_some(state.entry.id));
                    state.admission = admission;
                }
                Ok(admission) => {
                    let is = admission.standing.as_str();
                    refused.push((state.link.clone(), format!("the peer is {is} now: make the link anew")));
                }
                Err(error) => refused.push((state.link.clone(), error.to_string())),
            }
        }
        // What is held ends soon by itself.
        let may_stay = |held: &StaleLink| only_ended || held.link().is_none_or(|link| judge(link).is_ok());
        let over: Vec<u32> = self.held.iter().filter(|held| !may_stay(held)).map(|held| held.entry.id).collect();
        changed.into_iter().for_each(|id| self.put_flags(id));
        let lost = over.into_iter().filter_map(|id| self.release(id)).collect();
        (refused, lost)
    }

    /// Takes a link into service. Returns the one to the same peer that it replaces.
    pub fn link_up(&mut self, link: &Link, via: Via, admission: Admission) -> Result<Option<Link>, PlaneError> {
        let (id, peer, lane) = (link.local_id(), link.peer().name, link.peer().lane);
        let (mut entry, to) = (KeyedEntry::from(link.entry(PORT_USERSPACE)), link.addr());
        let role = role_on(link, &admission);
        (entry.role, entry.flags) = (role as u32, flags_of(&admission));
        if let Err(error) = self.planes.set_link(*entry, to) {
            // A part of the planes may have taken it.
            let _ = self.planes.remove_link(id);
            return Err(error);
        }
        let replaced = self.peers.insert((peer, lane), id);
        let replaced = replaced.and_then(|old| self.links.get(&old)).map(|old| old.link.clone());
        self.refusals.forget(&peer);
        self.events.tell(Event::LinkUp {
            peer,
            role: link_role(entry.role),
            standing: admission.standing.as_str(),
            via: via.to_string(),
            address: to.to_string(),
        });
        let (since, traces) = (Instant::now(), Allowance::default());
        self.links.insert(id, LinkState { link: link.clone(), via, since, admission, traces, entry, to });
        let changes = self.routes.link_up(role, peer, lane, id);
        self.carry_out(changes);
        self.meet(link);
        Ok(replaced)
    }

    /// The peer takes data frames on this link.
    pub fn link_ready(&mut self, link: &Link) {
        let (peer, id) = (link.peer().name, link.local_id());
        if let Some(role) = self.links.get(&id).and_then(|state| state.entry.role()) {
            let changes = self.routes.link_ready(role, peer, id);
            self.carry_out(changes);
            self.held.replaced(&peer, link.peer().lane, Instant::now());
        }
    }

    /// A peer got no link.
    pub fn refused(&mut self, peer: Name, via: &Via, reason: &str) {
        self.refusals.add(peer, reason.to_owned(), Instant::now());
        self.events.tell(Event::LinkRefused { peer, via: via.to_string(), reason: reason.to_owned() });
    }

    /// A link is closed. It goes out of service, unless frames may still come on it: because the
    /// peer is only about to learn that another has replaced it, or because the peer said nothing,
    /// and may forward on without its daemon: then it is held, and to be
    /// [watched](super::liveness). Returns whether it is.
    pub fn link_down(&mut self, link: &Link) -> bool {
        let (id, peer, lane) = (link.local_id(), link.peer().name, link.peer().lane);
        self.topology.link_down(id);
        if self.peers.get(&(peer, lane)) == Some(&id) {
            self.peers.remove(&(peer, lane));
        }
        let Some(LinkState { link, admission, entry, to, .. }) = self.links.remove(&id) else { return false };
        let role = role_on(&link, &admission);
        let is_replaced = self.routes.is_replaced(role, &peer, id);
        let is_silent = !is_replaced && link.fell_silent() && self.routes.link_silent(role, &peer, id);
        if !is_replaced && !is_silent {
            self.remove_link(role, peer, id);
            return false;
        }
        let time = if is_replaced { GRACE } else { GRACEFUL_RESTART_TIME };
        let (until, id) = (Instant::now() + time, Kept::Closed { link });
        let held = StaleLink { peer, lane, role, entry, to, until, standing: Some(admission.standing), id };
        if let Some(first) = self.held.keep(held) {
            self.release(first);
        }
        is_silent
    }

    /// Whether a link is held whose peer has no other of that lane.
    pub fn awaits(&self, link: &Link) -> bool {
        self.held.contains(link.local_id()) && !self.peers.contains_key(&(link.peer().name, link.peer().lane))
    }

    fn has_link(&self, peer: &Name) -> bool {
        self.links_of(peer).next().is_some()
    }

    /// The ids of the links to a peer.
    pub(super) fn links_of(&self, peer: &Name) -> impl Iterator<Item = u32> {
        self.peers.range((*peer, 0)..=(*peer, u8::MAX)).map(|(_, id)| *id)
    }

    fn remove_link(&mut self, role: LinkRole, peer: Name, id: u32) {
        let (changes, with_it) = self.routes.link_gone(role, peer, id);
        self.carry_out(changes);
        for id in [id].into_iter().chain(with_it) {
            self.held.take(id);
            if let Err(error) = self.planes.remove_link(id) {
                tracing::error!(link = id, %error, "the data plane keeps a link that is gone");
            }
        }
    }

    /// Writes the keys that a link has from now on to the data planes; `false` if it is gone, or a
    /// plane refuses.
    pub fn put_keys(&mut self, id: u32, keys: &LinkKeys) -> bool {
        let Some(state) = self.links.get_mut(&id) else { return false };
        keys.put(&mut state.entry);
        let result = self.planes.set_link(*state.entry, state.to);
        if let Err(error) = &result {
            tracing::error!(link = id, %error, "the data plane did not take a link's new keys; it keeps those it has");
        }
        result.is_ok()
    }

    /// Looks whether peers have moved to other addresses, as QUIC has validated; and what the paths
    /// to them take.
    pub fn follow_addresses(&mut self) {
        for state in self.links.values_mut() {
            let (to, mtu, carrier) = (state.link.addr(), state.link.mtu(), state.link.carrier());
            if (to, mtu, carrier) == (state.to, state.entry.mtu, state.entry.carrier) {
                continue;
            }
            let peer = format_args!("{:#}", state.link.peer().name).to_string();
            if to != state.to {
                tracing::info!(peer, from = %state.to, %to, "a peer moved");
            }
            if mtu != state.entry.mtu {
                tracing::debug!(peer, from = state.entry.mtu, to = mtu, "the MTU of a link changed");
            }
            (state.to, state.entry.mtu, state.entry.carrier) = (to, mtu, carrier);
            if let Err(error) = self.planes.set_link(*state.entry, to) {
                tracing::error!(%error, "the data plane did not take what changed on a link");
            }
        }
    }

    /// The interfaces to endpoints on this host are gone: they are to make links anew, and send
    /// through the daemon.
    pub fn close_links_by_pair(&self) {
        for state in self.links.values().filter(|state| state.link.is_by_pair()) {
            state.link.close("the interfaces between the switch and its host are gone");
        }
    }

    /// The link to a peer, if it is up; to an endpoint with several, the one that it prefers.
    pub fn link_to(&self, peer: &Name) -> Option<Link> {
        let preferred = self.routes.link_to(peer).filter(|id| self.links.contains_key(id));
        let id = preferred.or_else(|| self.links_of(peer).next())?;
        self.links.get(&id).map(|state| state.link.clone())
    }

    /// An endpoint wants on this link what it takes on one.
    pub fn prefer(&mut self, link: &Link) {
        let changes = self.routes.link_preferred(link.peer().name, link.local_id());
        self.carry_out(changes);
    }

    /// What an entity asks, over its link or (`by_tool`) through the admin socket.
    pub fn entity_request(&mut self, entity: Option<&NameProof>, by_tool: bool, request: EntityRequest) -> Next {
        let (switch, own) = (self.name(), self.identity.proof());
        // Who may use the admin socket runs this switch, and may have names listed.
        let lists = by_tool && entity.is_none() && matches!(request, EntityRequest::Query { .. });
        let entity = if lists { Some(&own) } else { entity };
        if self.rib.is_some() {
            return self.ask_rib(switch, entity, by_tool, &request);
        }
        self.to_rib(Request::Relay { switch, entity: entity.copied(), by_tool, request })
    }

    /// The link of an entity is gone: what tells the RIB.
    pub fn detach(&mut self, entity: Name) -> Next {
        if self.attached.remove(&entity) {
            self.events.tell(Event::Detached { entity });
        }
        let (now, switch) = (self.now(), self.name());
        match &mut self.rib {
            Some(rib) => Next::Answer(rib.detach(now, &switch, &entity)),
            None => self.to_rib(Request::Detach { switch, entity }),
        }
    }

    /// What a neighbouring switch asks or says.
    pub fn switch_request(&mut self, from: &Link, request: Request) -> Next {
        match request {
            Request::Ready => {
                self.link_ready(from);
                Next::Answer(Response::Done)
            }
            Request::Onward { to, hops, request } => self.passed_on(from, to, hops, *request),
            Request::Tier(message) => self.tier_across(from, *message),
            Request::TraceOn(request) => self.trace_enters(from, request),
            _ => refuse(RefusalCode::Malformed, "what is for the RIB or from it is passed on with whom it is for"),
        }
    }

    /// The links of an endpoint here.
    pub(super) fn links_of_endpoint(&self, entity: &Name) -> Vec<Link> {
        let links = self.links_of(entity).filter_map(|id| Some(self.links.get(&id)?.link.clone()));
        links.filter(|link| link.peer().role == Role::Endpoint).collect()
    }

    pub(super) fn push(&mut self, push: &FibPush) -> Response {
        if let Err(refusal) = self.check_fence(push.run) {
            return refusal.into();
        }
        match self.routes.push(push) {
            Ok(changes) => {
                let (generation, changes_made) = (push.generation, changes.len());
                tracing::debug!(generation, changes = changes_made, "FIB push");
                self.events.tell(Event::Routes { generation, changes: changes_made });
                self.carry_out(changes);
                match self.unplaced() {
                    None => Response::Done,
                    // Other refusals make the RIB send the whole again.
                    Some(reason) => Refusal::new(RefusalCode::Limit, reason).into(),
                }
            }
            Err(error) => Refusal::new(RefusalCode::Malformed, error.to_string()).into(),
        }
    }

    /// What the data plane lacks of the FIB, and why.
    pub fn unplaced(&self) -> Option<String> {
        let (names, reason) = &self.unplaced;
        (!names.is_empty()).then(|| format!("{} names have no route at switch {}: {reason}", names.len(), self.name()))
    }

    /// Takes out what the RIB here has to say; what is for this switch is done at once.
    pub fn rib_effects(&mut self) -> Vec<Outgoing> {
        let mut outgoing = Vec::new();
        loop {
            let now = self.now();
            outgoing.extend(self.federation_effects());
            let Some(rib) = &mut self.rib else { return outgoing };
            let (names, switches) = (rib.name_count(), rib.switch_count());
            if std::mem::replace(&mut self.told_of_rib, (names, switches)) != (names, switches) {
                self.events.tell(Event::Rib { names, switches });
            }
            let effects = rib.effects(now);
            if effects.is_empty() {
                return outgoing;
            }
            for effect in effects {
                let own = self.name();
                let (target, request, expects) = match effect {
                    Effect::Fib(push) if push.switch == own => {
                        let outcome = outcome(self.push(&push));
                        if let Some(rib) = &mut self.rib {
                            rib.pushed(now, &own, push.generation, outcome);
                        }
                        continue;
                    }
                    Effect::Fib(push) => {
                        let expects = Expects::Push(push.switch, push.generation);
                        (push.switch, Request::Fib(push), expects)
                    }
                    Effect::Peers(push) => {
                        let expects = Expects::UpdateId(UpdateId::from(&push));
                        (push.switch, Request::Peers(push), expects)
                    }
                    Effect::Detach { switch, entity } if switch == own => {
                        outgoing.extend(self.links_of_endpoint(&entity).into_iter().map(|link| Outgoing {
                            link: Some(link),
                            request: Request::Detach { switch, entity },
                            expects: Expects::Reattach,
                        }));
                        continue;
                    }
                    Effect::Detach { switch, entity } => (switch, Request::Detach { switch, entity }, Expects::Nothing),
                };
                let (link, request) = match request {
                    Request::Peers(push) if target == own => {
                        let link = self.check_fence(push.peers.run).ok().and_then(|()| self.link_to(&push.entity));
                        (link, Request::Peers(push))
                    }
                    request => (self.link_toward(&target).ok(), control::onward(target, request)),
                };
                outgoing.push(Outgoing { link, request, expects });
            }
        }
    }

    /// Tells the RIB here what came of something it sent.
    pub fn answered(&mut self, expects: Expects, response: Option<Response>) {
        match expects {
            Expects::Tier(to, sent) => return self.tier_answered(to, sent, response),
            Expects::Peerings(border) => return self.peerings_answered(border, response),
            _ => {}
        }
        let now = self.now();
        let Some(rib) = &mut self.rib else { return };
        match expects {
            Expects::Nothing | Expects::Reattach | Expects::Tier(..) | Expects::Peerings(_) => {}
            Expects::Push(switch, generation) => {
                rib.pushed(now, &switch, generation, response.map_or(Pushed::Failed, outcome));
            }
            Expects::UpdateId(told) => rib.told(now, told, matches!(response, Some(Response::Done))),
        }
    }

    /// Carries changes out in the data planes. Routes that find no room are kept, and placed when
    /// there is some.
    pub(super) fn carry_out(&mut self, changes: Vec<Change>) {
        for change in changes {
            let result = match change {
                Change::OwnBit(bit) => self.planes.set_own_bit(bit),
                Change::Reach { link, bits } => {
                    let live = self.links.get_mut(&link).map(|state| (&mut state.entry, state.to));
                    match live.or_else(|| self.held.get_mut(link).map(|held| (&mut held.entry, held.to))) {
                        Some((entry, to)) => {
                            entry.reach = bits;
                            self.planes.set_link(**entry, to)
                        }
                        None => Ok(()),
                    }
                }
                Change::NextHops(next_hops) => self.planes.set_next_hops(&next_hops),
                Change::Set(name, route) => {
                    // At once, so that a name that finds no room holds up no other.
                    match self.planes.set_route(name, &route) {
                        Ok(()) => _ = self.unplaced.0.remove(&name),
                        Err(error) => {
                            self.unplaced.0.insert(name, route);
                            self.unplaced.1 = error.to_string();
                        }
                    }
                    Ok(())
                }
                Change::Remove(name) => {
                    self.unplaced.0.remove(&name);
                    self.planes.remove_route(&name)
                }
            };
            if let Err(error) = result {
                tracing::error!(%error, "the data plane refused a change");
            }
        }
        self.place();
    }

    /// Gives the data planes the routes they do not hold yet, as far as they take them.
    fn place(&mut self) {
        let mut refusals = 0;
        let (planes, (routes, reason)) = (&mut self.planes, &mut self.unplaced);
        routes.retain(|name, route| {
            if refusals == MAX_REFUSALS {
                return true;
            }
            match planes.set_route(*name, route) {
                Ok(()) => false,
                Err(error) => {
                    (refusals, *reason) = (refusals + 1, error.to_string());
                    true
                }
            }
        });
        if let Some(reason) = self.unplaced() {
            tracing::error!("{reason}");
        }
    }

    /// Peers by the links they are on.
    pub fn peers_by_link(&self) -> BTreeMap<u32, Name> {
        let live = self.links.iter().map(|(id, state)| (*id, state.link.peer().name));
        live.chain(self.held.iter().map(|held| (held.entry.id, held.peer))).collect()
    }
}

/// What the data planes take the peer of a link for.
fn role_on(link: &Link, admission: &Admission) -> LinkRole {
    match link.peer().role {
        _ if admission.standing.is_border() => LinkRole::Border,
        Role::Endpoint => LinkRole::Endpoint,
        Role::Switch => LinkRole::Switch,
    }
}

/// What the entry of a link says of the peer's domain.
fn flags_of(admission: &Admission) -> u16 {
    match &admission.standing {
        Relationship::Border { ours, .. } if ours.transit => LinkEntry::TRANSIT,
        _ => 0,
    }
}

/// As the data planes know a peer.
pub fn link_role(role: u32) -> &'static str {
    match role {
        _ if role == LinkRole::Endpoint as u32 => "endpoint",
        _ if role == LinkRole::Border as u32 => "border",
        _ => "switch",
    }
}

/// Of a life of a RIB: higher than that of one with a lower `term`; and another one, should terms
/// be counted anew.
pub(super) fn run_id(term: u64) -> u64 {
    let random = crypto::random::<8>().map_or_else(|_| unix_nanos(), u64::from_ne_bytes);
    term << RUN_BITS | random & ((1 << RUN_BITS) - 1)
}

/// Puts an entity's request to the RIB.
pub(super) fn ask(
    rib: &mut Rib,
    now: Now,
    switch: Name,
    entity: Option<&NameProof>,
    by_tool: bool,
    request: &EntityRequest,
) -> Next {
    let response = rib.request(now, switch, entity, by_tool, request);
    let stated = match request {
        EntityRequest::Advertise { advert, .. } | EntityRequest::Subscribe { advert, .. } => Some(advert),
        EntityRequest::Revoke { .. } if matches!(response, Response::Done) => return Next::Keep(response),
        _ => None,
    };
    let statement = stated.and_then(|advert| {
        let Advert { name, entity, op, switch, .. } = advert.claims_unverified().ok()?;
        Some(Statement { name, entity, role: NameRole::of(op)?, switch })
    });
    match statement {
        Some(statement) if !matches!(response, Response::Refused(_)) && !statement.is_settled(rib) => {
            Next::Settle(response, statement)
        }
        _ => Next::Answer(response),
    }
}

/// What a switch's answer to a FIB push says of it.
fn outcome(response: Response) -> Pushed {
    match response {
        Response::Refused(refusal) if refusal.code == RefusalCode::Limit => Pushed::Partly(refusal.reason),
        Response::Refused(refusal) => {
            tracing::debug!(%refusal, "a switch refused a FIB push");
            Pushed::Failed
        }
        _ => Pushed::Done,
    }
}

pub(super) fn refuse(code: RefusalCode, reason: impl Into<String>) -> Next {
    Next::Answer(Refusal::new(code, reason).into())
}
