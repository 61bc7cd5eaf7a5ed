//! Three domains on loopback UDP, without root: a robot's and a cloud's, each below a third that
//! permits transit.
//!
//! ```text
//!                 T: top (RIB, border)
//!                /                    \
//!      A: edge (border)                B: far (RIB, border) ── cloud
//!         │
//!      A: hub (RIB) ── robot
//! ```

use std::time::{Duration, Instant};

use crate::member::{Domain, LONG, Place, Settings, now};
use crate::switch::{TIMEOUT, wait};
use gdp::unstable::{Node, NodeConfig, PublishOptions, Publisher, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, PeerCert, ReadGrant, Revocation, Signed, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::link_target::LinkTarget;
use gdp_ctl::client::Client;
use gdp_daemon::config::Inside;
use gdp_daemon::serve::Running;
use gdp_e2e::seal::Encoding;
use gdp_proto::admin::Request;
use gdp_proto::control::{EntityRequest, Record, Response};
use gdp_tests::programs::own;
use gdp_wire::Name;
use serde_json::{Value, json};
use tokio::time::timeout;

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_in_another_domain_hears_a_writer_through_a_third_that_may_not_know_of_it() {
    let f = Federation::start(false).await;
    let topic = Topic::new("/chatter");
    let (robot, cloud, nosy) = (entity(), entity(), entity());
    let robot_node = attach(&robot, &f.hub).await;
    let (cloud_node, nosy_node) = (attach(&cloud, &f.far).await, attach(&nosy, &f.top).await);
    // A reader in the third domain, which is out of scope.
    let mut nosy_subscription = topic.subscribe(&nosy, &nosy_node).await;
    let mut subscription = topic.subscribe(&cloud, &cloud_node).await;
    let mut publisher = topic.publish(&robot, &robot_node, &f.away).await;

    let writers = |place: &Place, name| query(place, name).into_iter().filter(Record::is_writer).count();
    wait("the cloud's RIB to know the robot", async || writers(&f.far, topic.name()) == 1).await;
    wait("the robot's RIB to know the cloud", async || query(&f.hub, topic.name()).len() == 2).await;
    assert_eq!(writers(&f.top, topic.name()), 0, "the third domain only passes it on");
    exchange(&robot, &mut publisher, &mut subscription).await;
    assert!(f.carried().await >= 20);
    assert!(timeout(Duration::from_millis(300), nosy_subscription.recv()).await.is_err(), "it is out of scope");

    // The third domain hides its inside, and so does the cloud's domain.
    let (trace, text) = trace(&f.hub, topic.name()).await.expect("a whole trace");
    let hops = trace["paths"][0]["hops"].as_array().unwrap();
    let switches: Vec<_> = hops.iter().map(|hop| hop["switch"].as_str().unwrap().to_owned()).collect();
    assert_eq!(switches, [f.hub.name.to_string(), f.edge.name.to_string()], "{trace}");
    assert_eq!(crossed(&trace), [entry(1, &f.top_domain, &f.top, 0), entry(2, &f.away, &f.far, 1)], "{trace}");
    let masked = |domain: &Domain| format!("… inside of domain {:#} (masked)", domain.identity.name());
    assert!(text.contains(&masked(&f.top_domain)) && text.contains(&masked(&f.away)), "{text}");

    // No reader in the other domain subscribes to this name. A query there climbs to the RIB of the
    // parent domain.
    let other = Topic::new("/other");
    let _other = other.publish(&robot, &robot_node, &f.away).await;
    wait("a query to climb", async || writers(&f.far, other.name()) == 1).await;
    assert_eq!(writers(&f.top, other.name()), 0, "and only for whom it is in scope");
    assert_eq!(query(&f.far, Name::from_bytes([7; 32])).len(), 0);

    // The third domain revokes the first domain's transit right, which disconnects the first
    // domain.
    revoke(&f.top_domain, &f.top, &f.crossing);
    let is_lost = async || tier(&f.hub_running, &f.top_domain).await.is_some_and(|state| state == "lost");
    wait("the parent to be lost", is_lost).await;
    publisher.send(Encoding::Bytes, &[99]).await.unwrap();
    assert!(timeout(Duration::from_millis(300), subscription.recv()).await.is_err(), "nothing crosses any more");
}

#[tokio::test(flavor = "multi_thread")]
async fn borders_peer_on_demand_and_the_third_domain_carries_nothing_until_they_may_not_any_more() {
    let f = Federation::start(true).await;
    let is_direct = async || {
        let (status, far) = (f.edge_running.status().await, f.far.name.to_string());
        let links = status["links"].as_array().unwrap().clone();
        links.iter().any(|link| link["peer"] == far.as_str() && link["relationship"] == "border")
    };
    assert!(!is_direct().await, "nobody needs it");
    let topic = Topic::new("/chatter");
    let (robot, cloud) = (entity(), entity());
    let (robot_node, cloud_node) = (attach(&robot, &f.hub).await, attach(&cloud, &f.far).await);
    let mut subscription = topic.subscribe(&cloud, &cloud_node).await;
    let mut publisher = topic.publish(&robot, &robot_node, &f.away).await;
    wait("the borders to peer", is_direct).await;
    let mut before = f.carried().await;
    let deadline = Instant::now() + TIMEOUT;
    loop {
        exchange(&robot, &mut publisher, &mut subscription).await;
        let after = f.carried().await;
        if after == before {
            break;
        }
        assert!(Instant::now() < deadline, "the third domain goes on carrying it");
        before = after;
    }
    // The border of the cloud's domain reveals its inside, which is only itself.
    wait("a trace straight into the cloud's domain", async || {
        let Some((trace, text)) = trace(&f.hub, topic.name()).await else { return false };
        let is_open = text.contains("  inside of domain") && !text.contains("masked");
        is_open && crossed(&trace) == [entry(1, &f.away, &f.far, 1)]
    })
    .await;

    // Revoking the peering moves traffic back to the third domain.
    revoke(&f.home, &f.edge, f.peering.as_ref().unwrap());
    wait("the peering to end", async || !is_direct().await).await;
    exchange(&robot, &mut publisher, &mut subscription).await;
    assert!(f.carried().await >= before + 20);
}

/// Sends twenty messages, and checks that each arrives once and in order.
async fn exchange(robot: &Identity, publisher: &mut Publisher, subscription: &mut Subscription) {
    // Messages sent before that are not addressed to the cloud.
    wait("the robot to know the cloud", async || publisher.readers() == 1).await;
    for i in 0..20u8 {
        publisher.send(Encoding::Bytes, &[i]).await.unwrap();
        let message = timeout(TIMEOUT, subscription.recv()).await.expect("in time").expect("a message");
        assert_eq!((message.body.to_vec(), message.writer), (vec![i], robot.name()));
    }
}

/// The three domains.
struct Federation {
    top_domain: Domain,
    home: Domain,
    away: Domain,
    top: Place,
    edge: Place,
    hub: Place,
    far: Place,
    /// Rights that the third domain grants to the robot's domain.
    crossing: Signed<PeerCert>,
    /// Rights that the robot's domain grants to the cloud's domain.
    peering: Option<Signed<PeerCert>>,
    top_running: Running,
    edge_running: Running,
    hub_running: Running,
    _far_running: Running,
}

impl Federation {
    /// Starts the domains. `may_peer`: the robot's and the cloud's domain are peers, and the
    /// cloud's border is reachable and reveals its inside.
    async fn start(may_peer: bool) -> Self {
        let (top_domain, home, away) = (Domain::new(1), Domain::new(2), Domain::new(3));
        let [top, edge, hub, far] = ["top", "edge", "hub", "far"].map(Place::new);
        let crossing = top_domain.peer(&home, "peering,transit", LONG);
        let others = top_domain.peer(&away, "peering,transit", LONG);
        let peering = may_peer.then(|| home.peer(&away, "peering", LONG));
        let home_peers = [Some(home.peer(&top_domain, "peering", LONG)), peering.clone()];
        let home_peers: Vec<&Signed<PeerCert>> = home_peers.iter().flatten().collect();
        let away_peers = [away.peer(&top_domain, "peering", LONG), away.peer(&home, "peering", LONG)];
        let away_peers: Vec<&Signed<PeerCert>> = away_peers.iter().take(1 + usize::from(may_peer)).collect();

        let settings = top.member(&top_domain, "border", LONG).peers(&[&crossing, &others]);
        let top_running = settings.rib().start().await;
        let settings = edge.member(&home, "border", LONG).peers(&home_peers);
        let edge_running = settings.dials(&top).below(&top).start().await;
        let settings = hub.member(&home, "rib", LONG).peers(&home_peers);
        let hub_running = settings.dials(&edge).rib().start().await;
        let mut settings = far.member(&away, "border", LONG).peers(&away_peers).dials(&top).below(&top).rib();
        settings.0.public = vec![far.addr];
        if may_peer {
            settings.0.domain.as_mut().unwrap().trace = Inside::Open;
        }
        let far_running = settings.start().await;
        for (what, running) in [("hub", &hub_running), ("far", &far_running)] {
            wait(what, async || tier(running, &top_domain).await.is_some_and(|state| state == "up")).await;
        }
        Self {
            top_domain,
            home,
            away,
            top,
            edge,
            hub,
            far,
            crossing,
            peering,
            top_running,
            edge_running,
            hub_running,
            _far_running: far_running,
        }
    }

    /// Returns the number of frames that the third domain has forwarded.
    async fn carried(&self) -> u64 {
        let counters = &self.top_running.status().await["counters"];
        ["forwarded", "delivered"].iter().filter_map(|counter| counters[counter].as_u64()).sum()
    }
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

    async fn publish(&self, robot: &Identity, node: &Node, scope: &Domain) -> Publisher {
        let ad_cert = self.ad_cert(robot, &[scope]).into();
        node.publish(self.card.proof(), ad_cert, PublishOptions::reliable()).await.unwrap()
    }

    async fn subscribe(&self, cloud: &Identity, node: &Node) -> Subscription {
        let grant = self.grant(cloud).into();
        node.subscribe(self.card.proof(), grant, SubscribeOptions::reliable()).await.unwrap()
    }

    fn ad_cert(&self, to: &Identity, scope: &[&Domain]) -> Signed<AdCert> {
        let (name, entity) = (self.name(), to.name());
        let scope = scope.iter().map(|domain| domain.identity.name()).collect();
        let (serial, not_before, not_after) = (1, 0, (now() + LONG) as u64);
        issue(&self.owner, &AdCert { name, entity, scope, serial, not_before, not_after }).unwrap()
    }

    fn grant(&self, to: &Identity) -> Signed<ReadGrant> {
        let (name, to, serial) = (self.name(), Grantee::Entity(to.name()), 2);
        let (not_before, not_after) = (0, (now() + LONG) as u64);
        issue(&self.owner, &ReadGrant { name, to, serial, not_before, not_after }).unwrap()
    }
}

impl Settings {
    /// Makes the RIB of `parent`'s domain a parent of this RIB.
    fn below(mut self, parent: &Place) -> Self {
        let neighbours = self.0.neighbours.iter_mut();
        neighbours.filter(|near| near.address.switch == parent.name).for_each(|near| near.parent = true);
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

/// Returns the JSON and the text output of `gdp-ctl trace` at a daemon; `None` if the trace does
/// not reach the end.
async fn trace(place: &Place, name: Name) -> Option<(Value, String)> {
    let socket = place.file("switch.sock");
    let run = move |for_programs: &[&str]| {
        let mut command = own(env!("CARGO_BIN_EXE_gdp-ctl"));
        command.arg("--socket").arg(&socket).args(for_programs).args(["trace", &name.to_string()]);
        let output = command.env_remove("RUST_LOG").output().unwrap();
        output.status.success().then(|| String::from_utf8(output.stdout).unwrap())
    };
    let run = move || Some((serde_json::from_str(&run(&["-j"])?).unwrap(), run(&[])?));
    tokio::task::spawn_blocking(run).await.unwrap()
}

/// Returns the domains in a trace: depth, domain, entry switch, and number of local links of the
/// name.
fn crossed(trace: &Value) -> Vec<Value> {
    let domains = trace["paths"][0]["domains"].as_array().unwrap();
    let in_time = |domain: &Value| domain["rtt_us"].as_u64() > Some(0) && domain["inside"]["rtt_us"].is_u64();
    assert!(domains.iter().all(in_time), "{trace}");
    let entry =
        |domain: &Value| json!([domain["depth"], domain["domain"], domain["switch"], domain["inside"]["links"]]);
    domains.iter().map(entry).collect()
}

fn entry(depth: u8, domain: &Domain, switch: &Place, links: u32) -> Value {
    json!([depth, domain.identity.name(), switch.name, links])
}

/// Returns the state of the relation between a daemon's RIB and a neighbouring domain, if any.
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
        client.ask(&Request::Entity { entity: None, request: request.into() }).unwrap()
    })
}

fn query(place: &Place, name: Name) -> Vec<Record> {
    match ask(place, EntityRequest::Query { prefix: name.into(), after: None }) {
        Response::Records { records, .. } => records,
        other => panic!("{other:?}"),
    }
}

fn revoke(domain: &Domain, at: &Place, cert: &Signed<PeerCert>) {
    let serial = cert.claims_unverified().unwrap().serial;
    let claims = Revocation { name: domain.identity.name(), number: 1, floor: 0, revoked: vec![serial], signer: None };
    let revocation = issue(domain.identity.key(), &claims).unwrap();
    assert!(matches!(ask(at, EntityRequest::Revoke { proof: domain.identity.proof(), revocation }), Response::Done));
}
