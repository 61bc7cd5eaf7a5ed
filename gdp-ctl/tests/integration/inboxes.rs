//! Two entities at a whole daemon, without the SDK's node. They reach each other under their own
//! names while they are counterparts. The RIB notifies them of each other and of keys. A revocation
//! separates them immediately.

use gdp_wire::hop;
use std::time::{Duration, Instant, SystemTime};

use crate::switch::{TIMEOUT, config, wait};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Advert, AdvertOp, Grantee, ReadGrant, Revocation, RtCert, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::KeyBox;
use gdp_daemon::serve::{Running, start};
use gdp_link::link::Link;
use gdp_link::port::{InFrame, LinkAddr, OutFrame, Port, PortConfig, RecvBatch};
use gdp_proto::control::{EntityRequest, NameRole, Peers, RefusalCode, Request, Response};
use gdp_proto::peers::{Counterparts, PeerEvent};
use gdp_wire::table::PORT_USERSPACE;
use gdp_wire::{Header, Name};
use zerocopy::{FromBytes, IntoBytes};

#[tokio::test(flavor = "multi_thread")]
async fn counterparts_meet_in_their_inboxes_until_one_is_revoked() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let owner = SigningKey::generate().unwrap();
    let card = NameCard::create(owner.verify_key(), "topic", "/cmd_vel", "T", None).unwrap();
    let (name, proof) = (card.name(), card.proof());
    let mut robot = Endpoint::attach(&switch, &card, NameRole::Publisher).await;
    let mut cloud = Endpoint::attach(&switch, &card, NameRole::Subscriber).await;

    let (not_before, not_after) = (0, unix_seconds() + 3600);
    let scope = Vec::new();
    let cert = AdCert { name, entity: robot.name(), scope, serial: 1, not_before, not_after };
    let (ad_cert, advert) = (issue(&owner, &cert).unwrap().into(), robot.advert(AdvertOp::Publish, name, &switch));
    robot.state(EntityRequest::Advertise { proof, ad_cert, advert, everywhere: false }).await;
    let (to, serial) = (Grantee::Entity(cloud.name()), 2);
    let grant = issue(&owner, &ReadGrant { name, to, serial, not_before, not_after }).unwrap();
    let subscribe = |cloud: &Endpoint| {
        let advert = cloud.advert(AdvertOp::Subscribe, name, &switch);
        EntityRequest::Subscribe { proof, grant: grant.clone().into(), advert, everywhere: false }
    };
    cloud.state(subscribe(&cloud)).await;
    assert!(cloud.counterparts.get(&robot.name()).is_some(), "from the answer");
    robot.told().await;
    let reader = robot.counterparts.get(&cloud.name()).expect("from a push");
    assert_eq!(reader.box_key, cloud.identity.box_public());

    for _ in 0..2 {
        cloud.send(robot.name());
        assert_eq!(robot.receive().await, (cloud.name(), robot.name()));
        robot.send(cloud.name());
        assert_eq!(cloud.receive().await, (robot.name(), cloud.name()));
    }

    let key_box = KeyBox { name, writer: robot.name(), reader: cloud.name(), epoch: 1, sealed: vec![0; 113] };
    let key_box = issue(robot.identity.key(), &key_box).unwrap();
    assert!(matches!(robot.ask(EntityRequest::KeyBoxes { boxes: vec![key_box.clone()] }).await, Response::Done));
    assert_eq!(cloud.told().await, [PeerEvent::KeyBox(key_box)]);

    let revocation = Revocation { name, number: 1, floor: 0, revoked: vec![serial], signer: None };
    let request = EntityRequest::Revoke { proof, revocation: issue(&owner, &revocation).unwrap() };
    assert!(matches!(robot.ask(request).await, Response::Done));
    assert_eq!(cloud.told().await[0], PeerEvent::Revoked(revocation.clone()), "who is revoked knows why");
    assert_eq!(robot.told().await, [PeerEvent::Revoked(revocation), PeerEvent::Left(cloud.name())]);
    cloud.send(robot.name());
    let dropped = async || switch.status().await["counters"]["drop_no_route"].as_u64().unwrap_or_default() > 0;
    wait("frames not to reach the robot any more", dropped).await;
    cloud.serial += 1;
    let Response::Refused(refusal) = cloud.ask(subscribe(&cloud)).await else { panic!("it reads again") };
    assert_eq!(refusal.code, RefusalCode::Revoked);
    assert!(refusal.reason.contains("the ReadGrant with serial 2"), "{refusal}");
    switch.stop().await;
}

/// An attached entity with a role for one name.
struct Endpoint {
    identity: Identity,
    port: Port,
    link: Link,
    counterparts: Counterparts,
    serial: u64,
    sent: u64,
}

impl Endpoint {
    async fn attach(switch: &Running, card: &NameCard, role: NameRole) -> Self {
        let identity = Identity::generate("proxy").unwrap();
        let port = Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::endpoint(identity.clone())).unwrap();
        let link = port.dial(LinkAddr::udp(switch.udp_addr().unwrap()), Some(switch.name())).await.unwrap();
        let claims = RtCert { entity: identity.name(), switch: switch.name(), not_after: unix_seconds() + 3600 };
        let rt_cert = issue(identity.key(), &claims).unwrap();
        let counterparts = Counterparts::new(card.proof(), role).unwrap();
        let endpoint = Self { identity, port, link, counterparts, serial: 1, sent: 0 };
        let response = endpoint.ask(EntityRequest::Attach { rt_cert, resumes: false, lane: 0 }).await;
        assert!(matches!(response, Response::Attached { .. }), "{response:?}");
        endpoint
    }

    fn name(&self) -> Name {
        self.identity.name()
    }

    fn advert(&self, op: AdvertOp, name: Name, switch: &Running) -> gdp_core::cert::Signed<Advert> {
        let (entity, switch, box_key) = (self.name(), switch.name(), self.identity.box_public());
        let claims = Advert { op, name, entity, switch, serial: self.serial, lifetime: 60, box_key };
        issue(self.identity.key(), &claims).unwrap()
    }

    async fn ask(&self, request: EntityRequest) -> Response {
        self.link.request(&Request::Entity(request)).await.unwrap()
    }

    async fn state(&mut self, request: EntityRequest) {
        let response = self.ask(request).await;
        let Response::Peers(peers) = response else { panic!("{response:?}") };
        self.take(&peers);
    }

    fn take(&mut self, peers: &Peers) -> Vec<PeerEvent> {
        self.counterparts.take(unix_seconds(), peers).unwrap()
    }

    /// Waits for the next notification from the RIB.
    async fn told(&mut self) -> Vec<PeerEvent> {
        let request = tokio::time::timeout(TIMEOUT, self.link.accept_request()).await.expect("told in time");
        let (Request::Peers(push), responder) = request.expect("a live link") else { panic!("told something else") };
        assert_eq!(push.entity, self.name());
        let events = self.take(&push.peers);
        responder.respond(Response::Done).await.unwrap();
        events
    }

    fn send(&mut self, to: Name) {
        let mut header = Header::data(to, self.name(), 0);
        self.sent += 1;
        hop::stamp(&mut header, &self.link.entry(PORT_USERSPACE), self.sent);
        let frame = OutFrame { to: self.link.addr(), head: header.as_bytes(), body: &[] };
        assert_eq!(self.port.data().send_batch([frame]).sent, 1);
    }

    /// Returns the source and destination of the next data frame.
    async fn receive(&self) -> (Name, Name) {
        let (data, deadline) = (self.port.data(), Instant::now() + TIMEOUT);
        let mut batch = RecvBatch::new(1500);
        loop {
            assert!(Instant::now() < deadline, "no frame");
            tokio::task::block_in_place(|| data.wait_readable(Duration::from_millis(20))).unwrap();
            data.try_recv_batch(&mut batch).unwrap();
            if let Some(InFrame { bytes: frame, .. }) = batch.frames().next() {
                let (header, _) = Header::read_from_prefix(&*frame).unwrap();
                return (header.source, header.destination);
            }
        }
    }
}

fn unix_seconds() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs()
}
