//! A switch with a RIB that believes every entity, for the tests of nodes.
//!
//! It uses real ports and links, forwards frames with `gdp_wire::forward`, and can simulate each
//! way in which a RIB may misbehave.

use gdp_wire::hop;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use gdp_wire::replay::{self, Window};
use gdp_wire::table::PORT_USERSPACE;
use gdp_wire::{FrameType, Header, LinkEntry, Name, forward};
use parking_lot::Mutex;
use zerocopy::{FromBytes, IntoBytes};

use crate::node::{
    Client, LinkConfig, LinkState, LinkStatus, Node, NodeConfig, NodeError, PublishOptions, Publisher, Server,
    SubscribeOptions, Subscription, unix_seconds,
};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Advert, Grantee, Issued, ReadGrant, Reading, Revocation, Signed, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::KeyBox;
use gdp_core::name::NameProof;
use gdp_link::link::{Link, LinkIds};
use gdp_link::port::{DataSocket, LinkAddr, OutFrame, Port, PortConfig, RecvBatch};
use gdp_proto::control::{
    Credential, EntityRequest, NameRole, PathCosts, Peers, PeersExtent, PeersPush, Record, Refusal, RefusalCode,
    Request, Response,
};

pub struct Fabric {
    identity: Identity,
    address: std::net::SocketAddr,
    running: Option<Running>,
    rib: Arc<Mutex<Rib>>,
}

struct Running {
    port: Arc<Port>,
    accept: tokio::task::JoinHandle<()>,
    stop: Arc<AtomicBool>,
    forwarder: std::thread::JoinHandle<()>,
}

/// Decides whether a frame is delivered.
pub type Fate = Box<dyn FnMut(&Header, &[u8]) -> bool + Send>;

#[derive(Default)]
struct Rib {
    links: HashMap<u32, Link>,
    windows: HashMap<u32, Window>,
    counts: HashMap<u32, u64>,
    serials: HashMap<Name, u64>,
    records: HashMap<(Name, NameRole), Vec<Record>>,
    boxes: HashMap<(Name, Name), Vec<Signed<KeyBox>>>,
    revocations: HashMap<Name, Signed<Revocation>>,
    refuse: Option<RefusalCode>,
    /// The refusals of key boxes by name, and the number of refused requests.
    refuse_boxes: HashMap<Name, (RefusalCode, u32)>,
    told_revocations: u32,
    silent: bool,
    fate: Option<Fate>,
    /// Names that an entity receives on each of its links. Other names use the preferred link.
    everywhere: HashSet<(Name, Name)>,
    preferred: HashMap<Name, u8>,
    /// The path costs, and the links that report them.
    costs: PathCosts,
    watchers: HashSet<u32>,
    /// Links that drop all frames in both directions.
    cut: HashSet<(Name, u8)>,
    /// Links that answer no request.
    mute: HashSet<(Name, u8)>,
    run: u64,
    generation: u64,
}

impl Fabric {
    pub async fn start() -> Self {
        let mut fabric = Self {
            identity: Identity::generate("switch").unwrap(),
            address: "127.0.0.1:0".parse().unwrap(),
            running: None,
            rib: Arc::default(),
        };
        fabric.restart().await;
        fabric
    }

    pub async fn restart(&mut self) {
        let port = Port::udp(self.address, &PortConfig::switch(self.identity.clone(), LinkIds::new())).unwrap();
        let port = Arc::new(port);
        self.address = port.udp_addr().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let accept = tokio::spawn(accept_all(port.clone(), self.rib.clone()));
        let (data, rib, stopped) = (port.data(), self.rib.clone(), stop.clone());
        let forwarder = std::thread::spawn(move || {
            let mut batch = RecvBatch::new(1500);
            while !stopped.load(Ordering::Relaxed) {
                data.wait_readable(Duration::from_millis(20)).unwrap();
                while data.try_recv_batch(&mut batch).unwrap() > 0 {
                    batch.frames().for_each(|frame| forward_frame(frame.bytes, &mut rib.lock(), &data));
                }
            }
        });
        self.running = Some(Running { port, accept, stop, forwarder });
    }

    /// Stops the switch, which loses its state.
    pub async fn stop(&mut self) {
        let running = self.running.take().unwrap();
        running.stop.store(true, Ordering::Relaxed);
        running.accept.abort();
        running.forwarder.join().unwrap();
        running.port.close("going away").await;
        // The socket closes when its last user is dropped.
        {
            let mut rib = self.rib.lock();
            *rib = Rib { run: rib.run + 1, ..Rib::default() };
        }
        let port = Arc::downgrade(&running.port);
        drop(running.port);
        eventually("the address is free", || {
            port.strong_count() == 0 && std::net::UdpSocket::bind(self.address).is_ok()
        })
        .await;
    }

    pub fn target(&self) -> gdp_core::link_target::LinkTarget {
        format!("udp://{}", self.address).parse().unwrap()
    }

    pub async fn node(&self, kind: &str) -> Node {
        self.node_by(kind, [None]).await
    }

    /// Connects a node with one link for each of these budgets.
    pub async fn node_by<const N: usize>(&self, kind: &str, budgets: [Option<u64>; N]) -> Node {
        self.node_of(&Identity::generate(kind).unwrap(), budgets, None).await
    }

    /// Connects a node with a state folder.
    pub async fn node_of<const N: usize>(
        &self,
        identity: &Identity,
        budgets: [Option<u64>; N],
        state: Option<std::path::PathBuf>,
    ) -> Node {
        let switch = Some(self.identity.name());
        let links = budgets.map(|budget| LinkConfig { switch, budget, ..self.target().into() }).to_vec();
        let config = NodeConfig { links, state, ..NodeConfig::new(identity.clone(), self.target()) };
        let node = Node::connect(config).await.unwrap();
        let is_up = |link: &LinkStatus| link.state == LinkState::Up;
        eventually("all links are up", || node.links().iter().all(is_up) && node.links()[0].main).await;
        node
    }

    /// Sets whether a node's link drops all frames.
    pub fn cut(&self, node: &Node, lane: u8, cut: bool) {
        let (mut rib, place) = (self.rib.lock(), (node.name(), lane));
        if cut {
            rib.cut.insert(place)
        } else {
            rib.cut.remove(&place)
        };
    }

    /// Closes a node's link; the node reconnects.
    pub fn end_link(&self, node: &Node, lane: u8) {
        let links = self.rib.lock().links_of(&node.name());
        links.iter().filter(|link| link.peer().lane == lane).for_each(|link| link.close("as the test wants it"));
    }

    /// Stops answering requests on a node's link.
    pub fn mute(&self, node: &Node, lane: u8) {
        self.rib.lock().mute.insert((node.name(), lane));
    }

    pub fn links(&self) -> usize {
        self.rib.lock().links.len()
    }

    pub fn writers(&self, name: Name) -> usize {
        self.rib.lock().of(name, NameRole::Publisher).len()
    }

    /// Returns the serials of the certificates that a name's writers present.
    pub fn write_serials(&self, name: Name) -> Vec<u64> {
        let serial = |record: &Record| match &record.credential {
            Credential::Writer(cert) => cert.serials().unwrap()[0].1,
            Credential::Reader(_) => unreachable!("of a writer"),
        };
        self.rib.lock().of(name, NameRole::Publisher).iter().map(serial).collect()
    }

    pub fn has_subscriber(&self, name: Name) -> bool {
        !self.rib.lock().of(name, NameRole::Subscriber).is_empty()
    }

    /// Sets the decision on each later frame.
    pub fn set_fate(&self, fate: Option<Fate>) {
        self.rib.lock().fate = fate;
    }

    /// Sends all entities of a name their counterparts.
    pub async fn tell(&self, name: Name) {
        let pushes = self.rib.lock().pushes(name);
        for (link, push) in pushes {
            // An entity with a forged record has no role in the name.
            link.request(&Request::Peers(push)).await.unwrap();
        }
    }

    /// Publishes the owner's revocation of certificates.
    pub async fn revoke(&self, revocation: Signed<Revocation>) {
        let name = revocation.claims_unverified().unwrap().name;
        self.rib.lock().revocations.insert(name, revocation);
        self.tell(name).await;
    }

    pub fn all_boxes(&self) -> Vec<Signed<KeyBox>> {
        self.rib.lock().boxes.values().flatten().cloned().collect()
    }

    /// Returns the key boxes stored for a reader of a name.
    pub fn boxes(&self, name: Name, reader: &Node) -> Vec<KeyBox> {
        let rib = self.rib.lock();
        let boxes = rib.boxes.get(&(name, reader.name())).into_iter().flatten();
        boxes.map(|signed| signed.claims_unverified().unwrap()).collect()
    }

    pub fn serial(&self, entity: Name) -> u64 {
        self.rib.lock().serials[&entity]
    }

    pub fn set_serial(&self, entity: Name, serial: u64) {
        self.rib.lock().serials.insert(entity, serial);
    }

    /// Refuses every advertisement and subscription.
    pub fn refuse(&self, code: Option<RefusalCode>) {
        self.rib.lock().refuse = code;
    }

    /// Refuses key boxes of a name.
    pub fn refuse_boxes(&self, name: Name, code: RefusalCode) {
        self.rib.lock().refuse_boxes.insert(name, (code, 0));
    }

    pub fn refused_boxes(&self, name: Name) -> u32 {
        self.rib.lock().refuse_boxes[&name].1
    }

    /// Accepts key boxes of every name again.
    pub fn take_boxes(&self) {
        self.rib.lock().refuse_boxes.clear();
    }

    /// Returns the number of revocations that nodes have forwarded.
    pub fn told_revocations(&self) -> u32 {
        self.rib.lock().told_revocations
    }

    /// Sets whether nodes are notified when their counterparts change.
    pub fn push_peers(&self, push: bool) {
        self.rib.lock().silent = !push;
    }

    /// Changes the path costs and reports them.
    pub async fn set_costs(&self, costs: PathCosts) {
        let watching: Vec<Link> = {
            let mut rib = self.rib.lock();
            rib.costs = costs.clone();
            rib.watchers.iter().filter_map(|id| rib.links.get(id)).cloned().collect()
        };
        for link in watching {
            link.request(&Request::Costs(costs.clone())).await.unwrap();
        }
    }

    pub fn switch(&self) -> Name {
        self.identity.name()
    }

    /// Adds a record that claims that `node` may write `name`.
    pub fn lie(&self, name: Name, node: &Node, proof: NameProof, cert: Issued<AdCert>) {
        let mut rib = self.rib.lock();
        let records = rib.records.get_mut(&(name, NameRole::Publisher)).unwrap();
        let entity = node.0.state.identity.proof();
        let honest = records[0].clone();
        records.push(Record { proof, entity, credential: Credential::Writer(cert), ..honest });
    }
}

/// The owner of one name, who issues its certificates.
pub struct Owner {
    key: SigningKey,
    card: NameCard,
}

impl Owner {
    pub fn new(topic: &str) -> Self {
        let key = SigningKey::generate().unwrap();
        let metadata = [("kind", "topic"), ("topic", topic), ("nonce", "1")];
        let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned())).collect();
        let card = NameCard::new(key.verify_key(), metadata).unwrap();
        Self { key, card }
    }

    /// Returns an impostor with the same card but another key.
    pub fn of_card(card: NameCard) -> Self {
        Self { key: SigningKey::generate().unwrap(), card }
    }

    pub fn name(&self) -> Name {
        self.card.name()
    }

    pub fn card(&self) -> &NameCard {
        &self.card
    }

    pub fn ad_cert(&self, entity: Name) -> Issued<AdCert> {
        self.ad_cert_until(entity, 1, unix_seconds() + 60)
    }

    pub fn ad_cert_until(&self, entity: Name, serial: u64, not_after: u64) -> Issued<AdCert> {
        let name = self.name();
        let claims = AdCert { name, entity, scope: vec![], serial, not_before: 0, not_after };
        issue(&self.key, &claims).unwrap().into()
    }

    /// Publishes the name with reliable options.
    pub async fn publish(&self, node: &Node) -> Result<Publisher, NodeError> {
        self.publish_as(node, PublishOptions::reliable()).await
    }

    pub async fn publish_as(&self, node: &Node, options: PublishOptions) -> Result<Publisher, NodeError> {
        node.publish(self.card.proof(), self.ad_cert(node.name()), options).await
    }

    pub async fn subscribe(&self, node: &Node) -> Result<Subscription, NodeError> {
        self.subscribe_as(node, SubscribeOptions::reliable()).await
    }

    pub async fn subscribe_as(&self, node: &Node, options: SubscribeOptions) -> Result<Subscription, NodeError> {
        self.subscribe_by(node, 1, options).await
    }

    /// Subscribes with a grant that has this serial.
    pub async fn subscribe_by(
        &self,
        node: &Node,
        serial: u64,
        options: SubscribeOptions,
    ) -> Result<Subscription, NodeError> {
        node.subscribe(self.card.proof(), self.grant(node, serial), options).await
    }

    pub async fn serve(&self, node: &Node) -> Server {
        node.serve(self.card.proof(), self.ad_cert(node.name())).await.unwrap()
    }

    pub async fn client(&self, node: &Node) -> Client {
        node.client(self.card.proof(), self.grant(node, 1)).await.unwrap()
    }

    pub fn grant(&self, node: &Node, serial: u64) -> Reading {
        self.grant_until(node, serial, unix_seconds() + 60)
    }

    pub fn grant_until(&self, node: &Node, serial: u64, not_after: u64) -> Reading {
        let (name, to) = (self.name(), Grantee::Entity(node.name()));
        issue(&self.key, &ReadGrant { name, to, serial, not_before: 0, not_after }).unwrap().into()
    }

    /// Revokes the certificates with these serials.
    pub fn revocation(&self, number: u64, revoked: Vec<u64>) -> Signed<Revocation> {
        issue(&self.key, &Revocation { name: self.name(), number, floor: 0, revoked, signer: None }).unwrap()
    }
}

/// Timeout for all conditions in tests. It detects a failure and makes no statement about speed.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// Waits until a condition is true.
pub async fn eventually(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !condition() {
        assert!(Instant::now() < deadline, "not in time: {what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

async fn accept_all(port: Arc<Port>, rib: Arc<Mutex<Rib>>) {
    while let Some(link) = port.accept().await {
        let Ok(link) = link else { continue };
        rib.lock().links.insert(link.local_id(), link.clone());
        let rib = Arc::downgrade(&rib);
        tokio::spawn(async move {
            let mut unanswered = Vec::new();
            while let Some((request, responder)) = link.accept_request().await {
                let Some(rib) = rib.upgrade() else { return };
                if rib.lock().mute.contains(&(link.peer().name, link.peer().lane)) {
                    unanswered.push(responder);
                    continue;
                }
                let (response, pushes) = rib.lock().answer(&link, request);
                // Pushed before the response, unlike a real RIB. The first message of a new writer
                // is thus never too early.
                for (other, push) in pushes {
                    let _ = other.request(&Request::Peers(push)).await;
                }
                let _ = responder.respond(response).await;
            }
            if let Some(rib) = rib.upgrade() {
                rib.lock().links.remove(&link.local_id());
            }
        });
    }
}

type Pushes = Vec<(Link, PeersPush)>;

impl Rib {
    fn answer(&mut self, link: &Link, request: Request) -> (Response, Pushes) {
        let entity = link.peer().name;
        let request = match request {
            Request::Entity(request) => request,
            Request::WatchCosts => {
                self.watchers.insert(link.local_id());
                return (Response::Costs(self.costs.clone()), Vec::new());
            }
            Request::Ready => {
                self.preferred.insert(entity, link.peer().lane);
                return (Response::Done, Vec::new());
            }
            other => panic!("an endpoint sent {other:?}"),
        };
        let serial = match &request {
            EntityRequest::Attach { .. } => {
                let serial = *self.serials.entry(entity).or_default();
                return (Response::Attached { serial }, Vec::new());
            }
            EntityRequest::Query { prefix, .. } => {
                let found = self.records.iter().filter(|((name, _), _)| prefix.matches(name));
                let records = found.flat_map(|(_, records)| records.clone()).collect();
                return (Response::Records { records, truncated: false }, Vec::new());
            }
            EntityRequest::KeyBoxes { boxes } => {
                let name = boxes[0].claims_unverified().unwrap().name;
                if let Some((code, asked)) = self.refuse_boxes.get_mut(&name) {
                    *asked += 1;
                    return (Refusal::new(*code, "as the test wants it").into(), Vec::new());
                }
                return (Response::Done, self.keep(boxes));
            }
            EntityRequest::Revoke { .. } => {
                self.told_revocations += 1;
                return (Response::Done, Vec::new());
            }
            EntityRequest::Advertise { advert, .. }
            | EntityRequest::Subscribe { advert, .. }
            | EntityRequest::Withdraw { advert } => advert.verify(&link.peer().key, unix_seconds()).unwrap().serial,
        };
        let floor = self.serials.get_mut(&entity).expect("attached first");
        if serial <= *floor {
            return (Refusal::new(RefusalCode::ReplayedSerial, format!("{serial} <= {floor}")).into(), Vec::new());
        }
        *floor = serial;
        if let Some(code) = self.refuse {
            return (Refusal::new(code, "as the test wants it").into(), Vec::new());
        }
        if let EntityRequest::Subscribe { proof, everywhere, .. } = &request {
            let place = (proof.name().unwrap(), entity);
            if *everywhere {
                self.everywhere.insert(place)
            } else {
                self.everywhere.remove(&place)
            };
        }
        let (proof, credential, advert) = match request {
            EntityRequest::Advertise { proof, ad_cert, advert, .. } => (proof, Credential::Writer(ad_cert), advert),
            EntityRequest::Subscribe { proof, grant, advert, .. } => (proof, Credential::Reader(grant), advert),
            EntityRequest::Withdraw { advert } => {
                let name = advert.claims_unverified().unwrap().name;
                for ((of, _), records) in &mut self.records {
                    records.retain(|other| *of != name || other.entity != link.peer().proof);
                }
                return (Response::Done, self.pushes(name));
            }
            _ => unreachable!("answered above"),
        };
        let name = proof.name().unwrap();
        let Advert { switch, op, .. } = advert.claims_unverified().unwrap();
        let role = NameRole::of(op).unwrap();
        let record = Record { name, proof, entity: link.peer().proof, switch, credential, advert, expires_in: 60 };
        let records = self.records.entry((name, role)).or_default();
        records.retain(|other| other.entity != record.entity);
        records.push(record);
        let peers = self.peers(name, role, entity);
        (Response::Peers(peers), self.pushes_to(name, role.counterpart()))
    }

    fn of(&self, name: Name, role: NameRole) -> &[Record] {
        self.records.get(&(name, role)).map_or(&[], Vec::as_slice)
    }

    /// Stores the key boxes, those of the two newest epochs only.
    fn keep(&mut self, boxes: &[Signed<KeyBox>]) -> Pushes {
        let mut names = Vec::new();
        for signed in boxes {
            let KeyBox { name, reader, .. } = signed.claims_unverified().unwrap();
            let kept = self.boxes.entry((name, reader)).or_default();
            kept.push(signed.clone());
            if kept.len() > 2 {
                kept.remove(0);
            }
            names.push(name);
        }
        names.dedup();
        let takers = [NameRole::Subscriber, NameRole::Server];
        let mut pushes: Pushes =
            names.iter().flat_map(|name| takers.map(|role| self.pushes_to(*name, role))).flatten().collect();
        for entity in names {
            // The key boxes for an entity's own name.
            if let Some(link) = self.link_of(&entity) {
                let (role, switch) = (NameRole::Subscriber, entity);
                let peers = self.peers(entity, role, entity);
                pushes.push((link, PeersPush { switch, entity, name: entity, role, peers }));
            }
        }
        pushes
    }

    /// Returns all counterparts of an entity in a name, as this RIB reports them.
    fn peers(&mut self, name: Name, role: NameRole, entity: Name) -> Peers {
        self.generation += 1;
        let extent = PeersExtent::Whole { part: 0, last: true };
        let (run, generation, departed) = (self.run, self.generation, Vec::new());
        let records = self.of(name, role.counterpart()).to_vec();
        let boxes = match role {
            NameRole::Subscriber | NameRole::Server => self.boxes.get(&(name, entity)).cloned().unwrap_or_default(),
            _ => Vec::new(),
        };
        Peers {
            run,
            settling: false,
            generation,
            extent,
            records,
            departed,
            revocation: self.revocations.get(&name).cloned(),
            boxes,
        }
    }

    fn pushes(&mut self, name: Name) -> Pushes {
        NameRole::ALL.into_iter().flat_map(|role| self.pushes_to(name, role)).collect()
    }

    fn pushes_to(&mut self, name: Name, role: NameRole) -> Pushes {
        if self.silent {
            return Vec::new();
        }
        let told: Vec<_> = self.of(name, role).iter().map(|r| (r.entity.name().unwrap(), r.switch)).collect();
        let mut pushes = Vec::new();
        for (entity, switch) in told {
            let Some(link) = self.link_of(&entity) else { continue };
            let peers = self.peers(name, role, entity);
            pushes.push((link, PeersPush { switch, entity, name, role, peers }));
        }
        pushes
    }

    /// Returns the link that the entity prefers.
    fn link_of(&self, entity: &Name) -> Option<Link> {
        let preferred = self.preferred.get(entity).copied().unwrap_or(0);
        self.links_of(entity).into_iter().min_by_key(|link| link.peer().lane != preferred)
    }

    fn links_of(&self, entity: &Name) -> Vec<Link> {
        self.links.values().filter(|link| link.peer().name == *entity).cloned().collect()
    }

    fn passes(&self, link: &Link) -> bool {
        !self.cut.contains(&(link.peer().name, link.peer().lane))
    }

    fn entry(&self, id: u32) -> Option<(LinkEntry, LinkAddr)> {
        self.links.get(&id).map(|link| (link.entry(PORT_USERSPACE), link.addr()))
    }
}

fn forward_frame(frame: &[u8], rib: &mut Rib, data: &DataSocket) {
    let available = frame.len();
    let Ok((mut header, payload)) = Header::read_from_prefix(frame) else { return };
    let Some((ingress, from)) = rib.entry(header.link_id()) else { return };
    if !rib.links.get(&ingress.id).is_some_and(|link| rib.passes(link)) {
        return;
    }
    let window = rib.windows.entry(ingress.id).or_insert_with(replay::empty);
    match forward::accept(&header, available, &ingress, window) {
        Ok(FrameType::Data) => {}
        Ok(FrameType::Echo) => {
            header.become_answer();
            return send(rib, data, &mut header, &ingress, (from, &[]));
        }
        _ => return,
    }
    if rib.fate.as_mut().is_some_and(|fate| !fate(&header, payload)) {
        return;
    }
    let readers = [NameRole::Subscriber, NameRole::Server].map(|role| rib.of(header.destination, role)).concat();
    let mut takers = Vec::new();
    for reader in readers.iter().map(|record| record.entity.name().unwrap()) {
        match rib.everywhere.contains(&(header.destination, reader)) {
            true => takers.extend(rib.links_of(&reader)),
            false => takers.extend(rib.link_of(&reader)),
        }
    }
    // An entity receives the frames to its own name.
    takers.extend(rib.links_of(&header.destination));
    takers.retain(|link| rib.passes(link));
    for link in takers {
        send(rib, data, &mut header, &link.entry(PORT_USERSPACE), (link.addr(), payload));
    }
}

fn send(rib: &mut Rib, data: &DataSocket, header: &mut Header, egress: &LinkEntry, (to, payload): (LinkAddr, &[u8])) {
    let count = rib.counts.entry(egress.id).or_default();
    *count += 1;
    hop::stamp(header, egress, *count);
    data.send_batch([OutFrame { to, head: header.as_bytes(), body: payload }]);
}
