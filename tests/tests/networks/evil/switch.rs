//! The switch and its RIB; see the parent module.

use gdp_wire::hop;
use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Result;
use gdp_core::cert::{Revocation, Signed};
use gdp_core::identity::Identity;
use gdp_core::keys::KeyBox;
use gdp_core::link_target::LinkTarget;
use gdp_core::name::NameProof;
use gdp_link::link::{Link, LinkIds};
use gdp_link::port::{DataSocket, OutFrame, Port, PortConfig, RecvBatch};
use gdp_proto::control::{
    EntityRequest, NameRole, Peers, PeersExtent, PeersPush, Record, Refusal, RefusalCode, Request, Response,
};
use gdp_rib::rib::fib::Pushed;
use gdp_rib::rib::{Effect, Limits, Now, Rib, RibRun, UpdateId};
use gdp_wire::replay::{self, Window};
use gdp_wire::table::PORT_USERSPACE;
use gdp_wire::{FrameType, Header, Name, forward};
use parking_lot::{Mutex, MutexGuard};
use tokio::runtime::Handle;
use zerocopy::{FromBytes, IntoBytes};

/// A frame in the switch, after the check of its hop tag. The switch stamps it again for each
/// receiver in `to`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    pub destination: Name,
    pub source: Name,
    /// Flags, traffic class and ECN.
    pub flags: u8,
    pub payload: Vec<u8>,
    /// The entities at the switch that receive the destination, according to the RIB.
    pub to: Vec<Name>,
}

/// The test's change to the frames of one batch.
type Tamper = Box<dyn FnMut(&mut Vec<Frame>) + Send>;
/// The test's change to the RIB's update to an entity about a name.
type Lie = Box<dyn FnMut(Name, Name, NameRole, &mut Peers) + Send>;
/// Selects requests that never reach the RIB, although the switch confirms them.
type Deaf = Box<dyn FnMut(&EntityRequest) -> bool + Send>;

/// The switch. Dropping it ends it.
pub struct Switch(Arc<Inner>);

struct Inner {
    identity: Identity,
    address: SocketAddr,
    data: Arc<DataSocket>,
    port: Port,
    state: Mutex<State>,
    start: Instant,
    stopped: AtomicBool,
    runtime: Handle,
}

struct State {
    rib: Rib,
    runs: u64,
    /// Links by the id in arriving frames.
    links: HashMap<u32, Line>,
    routes: HashMap<Name, Vec<Name>>,
    tamper: Tamper,
    lie: Lie,
    deaf: Deaf,
    /// Entities that are attached without a link, and what they received.
    rogues: HashMap<Name, Heard>,
    lies: u64,
}

struct Line {
    link: Link,
    window: Window,
    count: u64,
}

#[derive(Default)]
pub struct Heard {
    pub pushes: Vec<PeersPush>,
    pub frames: Vec<Frame>,
}

impl Switch {
    /// Starts an honest switch. Call within a tokio runtime.
    pub fn start() -> Result<Self> {
        let identity = Identity::generate("switch")?;
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        let port = Port::udp(address, &PortConfig::switch(identity.clone(), LinkIds::new()))?;
        let state = State {
            rib: new_rib(&identity, 1),
            runs: 1,
            links: HashMap::new(),
            routes: HashMap::new(),
            tamper: Box::new(|_| {}),
            lie: Box::new(|_, _, _, _| {}),
            deaf: Box::new(|_| false),
            rogues: HashMap::new(),
            lies: 0,
        };
        let inner = Arc::new(Inner {
            address: port.udp_addr().unwrap_or(address),
            data: port.data(),
            identity,
            port,
            state: Mutex::new(state),
            start: Instant::now(),
            stopped: AtomicBool::new(false),
            runtime: Handle::current(),
        });
        inner.report();
        tokio::spawn(accept_all(inner.clone()));
        let forwarding = inner.clone();
        std::thread::Builder::new().name("evil-switch".into()).spawn(move || forwarding.forward_all())?;
        Ok(Self(inner))
    }

    pub fn name(&self) -> Name {
        self.0.identity.name()
    }

    pub fn target(&self) -> LinkTarget {
        LinkTarget::Udp { host: self.0.address.ip().to_string(), port: self.0.address.port(), interface: None }
    }

    /// Changes all frames from now on with this function.
    pub fn tamper(&self, tamper: impl FnMut(&mut Vec<Frame>) + Send + 'static) {
        self.0.state().tamper = Box::new(tamper);
    }

    /// Changes all updates of the RIB from now on with this function. Its arguments are the entity,
    /// the name, the entity's role and the update.
    pub fn lie(&self, lie: impl FnMut(Name, Name, NameRole, &mut Peers) + Send + 'static) {
        self.0.state().lie = Box::new(lie);
    }

    /// From now on, confirms the selected requests without executing them.
    pub fn refuse_to_hear(&self, deaf: impl FnMut(&EntityRequest) -> bool + Send + 'static) {
        self.0.state().deaf = Box::new(deaf);
    }

    /// Replaces the RIB by an empty one, and has all entities attach again.
    pub fn restart_rib(&self) {
        {
            let mut state = self.0.state();
            state.runs += 1;
            state.rib = new_rib(&self.0.identity, state.runs);
        }
        self.0.report();
    }

    /// Sends frames of the test's own making.
    pub fn inject(&self, frames: &[Frame]) {
        self.0.send(&mut self.0.state(), frames);
    }

    /// Sends these frames repeatedly, as fast as one thread can, until `stop` is set.
    pub fn flood(&self, frames: Vec<Frame>, stop: Arc<AtomicBool>) -> JoinHandle<()> {
        let inner = self.0.clone();
        std::thread::spawn(move || {
            while !stop.load(Ordering::Relaxed) {
                // Lets legitimate frames through the switch in between.
                (0..16).for_each(|_| inner.send(&mut inner.state(), &frames));
                std::thread::yield_now();
            }
        })
    }

    /// Sends the RIB a request as the entity of `proof`, or as no entity. Requests that the switch
    /// otherwise suppresses reach the RIB too.
    pub fn ask(&self, proof: Option<&NameProof>, request: &EntityRequest) -> Response {
        self.0.ask(proof, request, &mut self.0.state())
    }

    /// Sends an entity an update that the RIB never made. The update claims to be complete and to
    /// come from a RIB that has just started.
    pub async fn tell(
        &self,
        entity: Name,
        (name, role): (Name, NameRole),
        records: Vec<Record>,
        revocation: Option<Signed<Revocation>>,
        boxes: Vec<Signed<KeyBox>>,
    ) -> Result<Response> {
        let (link, lies) = {
            let mut state = self.0.state();
            state.lies += 1;
            (state.link_to(entity), state.lies)
        };
        let link = link.ok_or_else(|| anyhow::anyhow!("{entity:#} has no link here"))?;
        let (run, extent, departed) = (u64::MAX - lies, PeersExtent::Whole { part: 0, last: true }, Vec::new());
        let peers = Peers { run, settling: false, generation: 1, extent, records, departed, revocation, boxes };
        let push = PeersPush { switch: self.name(), entity, name, role, peers };
        Ok(link.request(&Request::Peers(push)).await?)
    }

    /// Returns the records of the RIB.
    pub fn records(&self) -> Vec<Record> {
        let now = self.0.now();
        self.0.state().rib.records(now, None, usize::MAX).0
    }

    /// Attaches an entity without a link from now on, and stores what it receives.
    pub fn host(&self, rogue: Name) {
        self.0.state().rogues.entry(rogue).or_default();
    }

    /// Returns what a hosted entity has received since the last call.
    pub fn heard(&self, rogue: Name) -> Heard {
        self.0.state().rogues.get_mut(&rogue).map(std::mem::take).unwrap_or_default()
    }
}

impl Drop for Switch {
    fn drop(&mut self) {
        self.0.stopped.store(true, Ordering::Relaxed);
        self.0.data.wake();
        let mut state = self.0.state();
        state.links.drain().for_each(|(_, line)| line.link.close("the switch ends"));
    }
}

impl Inner {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    fn now(&self) -> Now {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Now { unix: unix.as_secs(), clock: self.start.elapsed() }
    }

    /// Reports the switch and all entities with links to the RIB, as a switch does.
    fn report(self: &Arc<Self>) {
        let state = &mut *self.state();
        let attached: Vec<Name> = state.links.values().map(|line| line.link.peer().name).collect();
        state.rib.report(self.now(), &self.identity.proof(), &attached, None);
        self.carry_out(state);
    }

    fn ask(self: &Arc<Self>, proof: Option<&NameProof>, request: &EntityRequest, state: &mut State) -> Response {
        let mut response = state.rib.request(self.now(), self.identity.name(), proof, false, request);
        // The RIB's routes are installed before the response.
        self.carry_out(state);
        let stated = match request {
            EntityRequest::Advertise { advert, .. } | EntityRequest::Subscribe { advert, .. } => {
                advert.claims_unverified().ok()
            }
            _ => None,
        };
        if let (Response::Peers(peers), Some(advert)) = (&mut response, stated)
            && let Some(role) = NameRole::of(advert.op)
        {
            (state.lie)(advert.entity, advert.name, role, peers);
        }
        response
    }

    /// Executes the RIB's pending effects.
    fn carry_out(self: &Arc<Self>, state: &mut State) {
        let (now, own) = (self.now(), self.identity.name());
        loop {
            let effects = state.rib.effects(now);
            if effects.is_empty() {
                break;
            }
            for effect in effects {
                match effect {
                    Effect::Fib(push) => state.rib.pushed(now, &push.switch, push.generation, Pushed::Done),
                    Effect::Detach { switch, entity } => {
                        if let Some(link) = state.link_to(entity) {
                            let request = Request::Detach { switch, entity };
                            self.runtime.spawn(async move { link.request(&request).await });
                        }
                    }
                    Effect::Peers(push) => self.tell(state, push),
                }
            }
        }
        let routes = state.rib.desired(&own);
        state.routes = routes.into_iter().map(|route| (route.name, route.locals)).collect();
    }

    fn tell(self: &Arc<Self>, state: &mut State, mut push: PeersPush) {
        let told = UpdateId::from(&push);
        (state.lie)(push.entity, push.name, push.role, &mut push.peers);
        let link = state.link_to(push.entity);
        if let Some(heard) = state.rogues.get_mut(&push.entity) {
            heard.pushes.push(push);
            state.rib.update_answered(self.now(), told, true);
            return;
        }
        let inner = self.clone();
        self.runtime.spawn(async move {
            let arrived = match link {
                Some(link) => matches!(link.request(&Request::Peers(push)).await, Ok(Response::Done)),
                None => false,
            };
            let state = &mut *inner.state();
            state.rib.update_answered(inner.now(), told, arrived);
            inner.carry_out(state);
        });
    }

    fn forward_all(&self) {
        let mut batch = RecvBatch::new(2048);
        while !self.stopped.load(Ordering::Relaxed) {
            if self.data.wait_readable(Duration::from_millis(100)).is_err() {
                return;
            }
            while self.data.try_recv_batch(&mut batch).unwrap_or(0) > 0 {
                let state = &mut *self.state();
                let mut frames: Vec<Frame> = batch.frames().filter_map(|frame| state.arrive(frame.bytes)).collect();
                (state.tamper)(&mut frames);
                self.send(state, &frames);
            }
        }
    }

    fn send(&self, state: &mut State, frames: &[Frame]) {
        for frame in frames {
            for to in &frame.to {
                if let Some(heard) = state.rogues.get_mut(to) {
                    heard.frames.push(frame.clone());
                }
                let Some(line) = state.links.values_mut().find(|line| line.link.peer().name == *to) else { continue };
                let mut header = Header::data(frame.destination, frame.source, frame.payload.len() as u16);
                header.flags = frame.flags;
                line.count += 1;
                hop::stamp(&mut header, &line.link.entry(PORT_USERSPACE), line.count);
                self.data.send_batch([OutFrame {
                    to: line.link.addr(),
                    head: header.as_bytes(),
                    body: &frame.payload,
                }]);
            }
        }
    }
}

impl State {
    fn link_to(&self, entity: Name) -> Option<Link> {
        self.links.values().map(|line| &line.link).find(|link| link.peer().name == entity).cloned()
    }

    fn arrive(&mut self, bytes: &[u8]) -> Option<Frame> {
        let (header, rest) = Header::read_from_prefix(bytes).ok()?;
        let line = self.links.get(&header.link_id())?;
        let accepted = forward::accept(&header, bytes.len(), &line.link.entry(PORT_USERSPACE), &line.window);
        if accepted != Ok(FrameType::Data) {
            return None;
        }
        let Header { destination, source, flags, .. } = header;
        let payload = rest.get(..header.payload_len().into())?.to_vec();
        let to = self.routes.get(&destination).cloned().unwrap_or_default();
        Some(Frame { destination, source, flags: flags & !Header::KEY_PHASE, payload, to })
    }
}

fn new_rib(identity: &Identity, id: u64) -> Rib {
    Rib::new(identity.name(), RibRun { id, settling: Duration::ZERO }, Limits::default())
}

async fn accept_all(inner: Arc<Inner>) {
    loop {
        let accepted = tokio::time::timeout(Duration::from_millis(100), inner.port.accept()).await;
        if inner.stopped.load(Ordering::Relaxed) {
            return;
        }
        // Handles expiries and retries.
        {
            let state = &mut *inner.state();
            state.rib.tick(inner.now());
            inner.carry_out(state);
        }
        match accepted {
            Ok(Some(Ok(link))) => _ = tokio::spawn(serve(inner.clone(), link)),
            Ok(None) => return,
            Ok(Some(Err(_))) | Err(_) => {}
        }
    }
}

/// Serves one link until it ends.
async fn serve(inner: Arc<Inner>, link: Link) {
    let (id, peer) = (link.local_id(), *link.peer());
    inner.state().links.insert(id, Line { link: link.clone(), window: replay::empty(), count: 0 });
    while let Some((request, responder)) = link.accept_request().await {
        let response = {
            let state = &mut *inner.state();
            match request {
                Request::Entity(request) if (state.deaf)(&request) => Response::Done,
                Request::Entity(request) => inner.ask(Some(&peer.proof), &request, state),
                _ => Refusal::new(RefusalCode::Unsupported, "this switch serves endpoints").into(),
            }
        };
        let _ = responder.respond(response).await;
    }
    let state = &mut *inner.state();
    state.links.remove(&id);
    if state.link_to(peer.name).is_none() {
        state.rib.detach(inner.now(), &inner.identity.name(), &peer.name);
        inner.carry_out(state);
    }
}
