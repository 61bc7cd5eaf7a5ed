//! Three domains on loopback UDP, without root: a robot's and a cloud's, each below a third one that lets them cross it.
//!
//! ```text
//!                 T: top (RIB, border)
//!                /                    \
//!      A: edge (border)                B: far (RIB, border) ── cloud
//!         │
//!      A: hub (RIB) ── robot
//! ```

mod member;
mod switch;

use std::time::Duration;

use gdp::cert::{AdCert, Grantee, Mode, ReadGrant, Revocation, Signed, issue};
use gdp::control::{EntityRequest, Record, Response};
use gdp::node::{LinkTarget, PublishOptions, SubscribeOptions};
use gdp::seal::Encoding;
use gdp::{Identity, Name, NameCard, Node, NodeConfig, SigningKey};
use gdp_ctl::admin::{Client, Request};
use gdp_ctl::serve::Running;
use member::{Domain, LONG, Place, Settings, now};
use switch::wait;
use tokio::time::timeout;

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_in_another_domain_hears_a_writer_through_a_third_that_may_not_know_of_it() {
    let (top_domain, home, away) = (Domain::new(1), Domain::new(2), Domain::new(3));
    let (top, edge, hub, far) = (Place::new("top"), Place::new("edge"), Place::new("hub"), Place::new("far"));
    let crossing = top_domain.peer(&home, "peering,transit", LONG);
    let others = top_domain.peer(&away, "peering,transit", LONG);
    let settings = top.member(&top_domain, "border", LONG).peers(&[&crossing, &others]).rib();
    let top_running = settings.start().await;
    let settings = edge.member(&home, "border", LONG).peers(&[&home.peer(&top_domain, "peering", LONG)]);
    let _edge_running = settings.dials(&top).below(&top).start().await;
    let hub_running = hub.member(&home, "rib", LONG).dials(&edge).rib().start().await;
    let settings = far.member(&away, "border", LONG).peers(&[&away.peer(&top_domain, "peering", LONG)]);
    let far_running = settings.dials(&top).below(&top).rib().start().await;
    for (what, running) in [("hub", &hub_running), ("far", &far_running)] {
        wait(what, async || tier(running, &top_domain).await.is_some_and(|state| state == "up")).await;
    }
    wait("the third to know both", async || {
        tier(&top_running, &home).await.is_some() && tier(&top_running, &away).await.is_some()
    })
    .await;

    let topic = Topic::new("/chatter");
    let (robot, cloud, nosy) = (entity(), entity(), entity());
    let [robot_node, cloud_node, nosy_node] =
        [attach(&robot, &hub).await, attach(&cloud, &far).await, attach(&nosy, &top).await];
    // In the third domain, out of scope.
    let grant = topic.grant(&nosy);
    let mut nosy_subscription =
        nosy_node.subscribe(topic.card.proof(), grant.into(), SubscribeOptions::reliable()).await.unwrap();
    let grant = topic.grant(&cloud);
    let mut subscription =
        cloud_node.subscribe(topic.card.proof(), grant.into(), SubscribeOptions::reliable()).await.unwrap();
    let ad_cert = topic.ad_cert(&robot, &[&away]);
    let mut publisher =
        robot_node.publish(topic.card.proof(), ad_cert.into(), PublishOptions::reliable()).await.unwrap();

    let writers = |place: &Place, name| query(place, name).into_iter().filter(Record::is_writer).count();
    wait("the cloud's RIB to know the robot", async || writers(&far, topic.name()) == 1).await;
    wait("the robot's RIB to know the cloud", async || query(&hub, topic.name()).len() == 2).await;
    assert_eq!(writers(&top, topic.name()), 0, "the third domain only passes it on");
    for i in 0..20u8 {
        publisher.send(Encoding::Bytes, &[i]).await.unwrap();
        let message = timeout(switch::PATIENCE, subscription.recv()).await.expect("in time").expect("a message");
        assert_eq!(message.body.to_vec(), [i], "in order, and once");
        assert_eq!(message.writer, robot.name());
    }
    assert!(timeout(Duration::from_millis(300), nosy_subscription.recv()).await.is_err(), "it is out of scope");

    // Nobody in the other domain takes this one: a query climbs.
    let other = Topic::new("/other");
    let ad_cert = other.ad_cert(&robot, &[&away]);
    let _other = robot_node.publish(other.card.proof(), ad_cert.into(), PublishOptions::reliable()).await.unwrap();
    wait("a query to climb", async || writers(&far, other.name()) == 1).await;
    assert_eq!(writers(&top, other.name()), 0, "and only for whom it is in scope");
    assert_eq!(query(&far, Name::from_bytes([7; 32])).len(), 0);

    // The third domain takes back what it lets the first do: that one is told why, and the other hears nothing any more.
    let serial = crossing.claims_unverified().unwrap().serial;
    revoke(&top_domain, &top, serial);
    wait("the parent to be lost", async || tier(&hub_running, &top_domain).await.is_some_and(|state| state == "lost"))
        .await;
    publisher.send(Encoding::Bytes, &[99]).await.unwrap();
    assert!(timeout(Duration::from_millis(300), subscription.recv()).await.is_err(), "nothing crosses any more");
}

/// A topic and its owner.
struct Topic {
    owner: SigningKey,
    card: NameCard,
}

impl Topic {
    fn new(of: &str) -> Self {
        let owner = SigningKey::generate().unwrap();
        let card = NameCard::create(owner.verify_key(), "topic", of, "T", None).unwrap();
        Self { owner, card }
    }

    fn name(&self) -> Name {
        self.card.name()
    }

    fn ad_cert(&self, to: &Identity, scope: &[&Domain]) -> Signed<AdCert> {
        let (name, entity, mode) = (self.name(), to.name(), Mode::Multicast);
        let scope = scope.iter().map(|domain| domain.identity.name()).collect();
        let (serial, not_before, not_after) = (1, 0, (now() + LONG) as u64);
        issue(&self.owner, &AdCert { name, entity, mode, scope, serial, not_before, not_after }).unwrap()
    }

    fn grant(&self, to: &Identity) -> Signed<ReadGrant> {
        let (name, to, serial) = (self.name(), Grantee::Entity(to.name()), 2);
        let (not_before, not_after) = (0, (now() + LONG) as u64);
        issue(&self.owner, &ReadGrant { name, to, serial, not_before, not_after }).unwrap()
    }
}

impl Settings {
    /// The RIB of that place's domain is a parent of this one's.
    fn below(mut self, parent: &Place) -> Self {
        let neighbours = self.0.neighbours.iter_mut();
        neighbours.filter(|near| near.place.switch == parent.name).for_each(|near| near.parent = true);
        self
    }
}

fn entity() -> Identity {
    Identity::generate("proxy").unwrap()
}

async fn attach(identity: &Identity, to: &Place) -> Node {
    let target: LinkTarget = format!("udp://{}", to.addr).parse().unwrap();
    Node::connect(NodeConfig::new(identity.clone(), target)).await.unwrap()
}

/// How a daemon's RIB stands with a neighbouring domain, if that is one.
async fn tier(running: &Running, domain: &Domain) -> Option<String> {
    let (status, name) = (running.status().await, domain.identity.name().to_string());
    let tiers = status["tiers"].as_array()?;
    let tier = tiers.iter().find(|tier| tier["domain"] == name.as_str())?;
    Some(tier["state"].as_str()?.to_owned())
}

fn ask(place: &Place, request: EntityRequest) -> Response {
    let socket = place.file("switch.sock");
    tokio::task::block_in_place(|| {
        let mut client = Client::connect(&socket).unwrap();
        client.ask_control(&Request::Entity { entity: None, request: request.into() }).unwrap()
    })
}

fn query(place: &Place, name: Name) -> Vec<Record> {
    match ask(place, EntityRequest::Query { prefix: name.into(), after: None }) {
        Response::Records { records, .. } => records,
        other => panic!("{other:?}"),
    }
}

fn revoke(domain: &Domain, at: &Place, serial: u64) {
    let claims = Revocation { name: domain.identity.name(), number: 1, floor: 0, revoked: vec![serial] };
    let revocation = issue(domain.identity.key(), &claims).unwrap();
    assert!(matches!(ask(at, EntityRequest::Revoke { proof: domain.identity.proof(), revocation }), Response::Done));
}
