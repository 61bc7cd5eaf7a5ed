//! Whole daemons on loopback UDP, without root. The tests cover two applications that publish and
//! read, and the state after an application, a link or a daemon ends.

use gdp_wire::hop;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant, SystemTime};

use crate::switch::{Chain, TIMEOUT, config, wait};
use gdp::unstable::{Node, NodeConfig, NodeError, PublishOptions, Publisher, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Advert, AdvertOp, Grantee, Issued, LinkState, ReadGrant, Reading, RtCert, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_daemon::config::{Config, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve::{Running, start};
use gdp_e2e::seal::Encoding;
use gdp_link::link::{Link, LinkIds};
use gdp_link::port::{LinkAddr, OutFrame, Port, PortConfig};
use gdp_proto::control::{EntityRequest, Flooded, MAX_HOPS, Request, Response};
use gdp_wire::table::PORT_USERSPACE;
use gdp_wire::{Header, Name};
use serde_json::Value;
use zerocopy::IntoBytes;

#[tokio::test(flavor = "multi_thread")]
async fn two_applications_meet_at_one_switch() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let at = switch.udp_addr().unwrap();
    let papers = Credentials::new();

    let reader = papers.reader(at).await;
    let mut subscription = papers.subscribe(&reader).await;
    let warnings = switch.status().await["warnings"].clone();
    assert_eq!(
        (&warnings[0]["kind"], &warnings[0]["names"][0]),
        (&"not_served".into(), &papers.card.name().to_string().into())
    );
    let writer = papers.writer(at).await;
    let mut publisher = papers.publish(&writer).await;
    assert_eq!(switch.status().await["warnings"], Value::Array(vec![]));
    // Routes of the name, and of both inboxes.
    wait("the routes", async || fib_names(&switch).await == 3).await;
    for i in 0..20u32 {
        publisher.send(Encoding::Bytes, &i.to_be_bytes()).await.unwrap();
        let message = next(&mut subscription).await;
        assert_eq!(message.body[..], i.to_be_bytes());
        assert_eq!(message.writer, papers.robot.name());
    }
    let big = vec![7; 1 << 20];
    publisher.send(Encoding::Bytes, &big).await.unwrap();
    assert_eq!(next(&mut subscription).await.body, big);

    drop(publisher);
    writer.close().await;
    wait("the name to be gone", async || fib_names(&switch).await == 0).await;
    let status = switch.status().await;
    assert_eq!(status["rib"]["names"], 1, "the subscription alone is left: {status}");
    switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_crosses_three_switches_and_outlives_the_loss_of_any_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let chain = Chain::new(folder.path());
    let mut running = Vec::new();
    for i in 0..3 {
        running.push(Some(start(chain.config(i)).await.unwrap()));
    }
    let papers = Credentials::new();
    let reader = papers.reader(chain.addrs[2]).await;
    let mut subscription = papers.subscribe(&reader).await;
    let writer = papers.writer(chain.addrs[0]).await;
    let mut publisher = papers.publish(&writer).await;
    exchange(&mut publisher, &mut subscription, "at first").await;
    let middle = running[1].as_ref().unwrap();
    wait("the frame to be counted", async || middle.status().await["counters"]["forwarded"].as_u64() > Some(0)).await;
    assert_eq!(fib_names(running[1].as_ref().unwrap()).await, 0, "a switch in transit holds no names");

    for (i, which) in ["the writer's switch", "the switch in the middle", "the RIB"].into_iter().enumerate() {
        running[i].take().unwrap().stop().await;
        // QUIC releases its socket in a separate task.
        wait("the address to be free", async || UdpSocket::bind(chain.addrs[i]).is_ok()).await;
        running[i] = Some(start(chain.config(i)).await.unwrap());
        exchange(&mut publisher, &mut subscription, &format!("after a restart of {which}")).await;
    }

    writer.close().await;
    for i in [0, 2] {
        let switch = running[i].as_ref().unwrap();
        wait("the name to be gone everywhere", async || fib_names(switch).await == 0).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_writer_that_was_told_done_loses_nothing_on_switches_further_on() {
    let folder = tempfile::tempdir().unwrap();
    let chain = Chain::new(folder.path());
    let mut running = Vec::new();
    for i in 0..3 {
        running.push(start(chain.config(i)).await.unwrap());
    }
    let papers = Credentials::new();
    let reader = papers.reader(chain.addrs[2]).await;
    let writer = papers.writer(chain.addrs[0]).await;
    for i in 0..20u32 {
        let papers = papers.with_another_name();
        let mut subscription = papers.subscribe(&reader).await;
        let mut publisher = papers.publish(&writer).await;
        publisher.send(Encoding::Bytes, &i.to_be_bytes()).await.unwrap();
        assert_eq!(next(&mut subscription).await.body[..], i.to_be_bytes());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_for_which_the_fib_has_no_room_is_refused_until_there_is_some() {
    let folder = tempfile::tempdir().unwrap();
    let chain = Chain::new(folder.path());
    let switches = [
        start(chain.config(0)).await.unwrap(),
        // Capacity for one name, and the inboxes of its writer and its reader here.
        start(Config { fib_capacity: 3, ..chain.config(1) }).await.unwrap(),
        start(chain.config(2)).await.unwrap(),
    ];
    let (first, second) = (Credentials::new(), Credentials::new());
    let mut nodes = Vec::new();
    for papers in [&first, &second] {
        nodes.push((papers.reader(chain.addrs[2]).await, papers.writer(chain.addrs[1]).await));
    }
    let _first = first.subscribe(&nodes[0].0).await;
    let mut subscription = second.subscribe(&nodes[1].0).await;
    let publisher = first.publish(&nodes[0].1).await;
    let error = second.try_publish(&nodes[1].1).await.err().expect("a refusal").to_string();
    assert!(error.contains("the FIB is full (3 names)") && error.contains("fib_capacity"), "{error}");
    assert!(error.contains(&chain.names[1].to_string()), "says where: {error}");
    wait("the refused name to be gone", async || switches[2].status().await["rib"]["names"] == 2).await;
    assert_eq!(switches[1].status().await["errors"], serde_json::json!([]));

    drop(publisher);
    nodes[0].1.close().await;
    wait("room", async || fib_names(&switches[1]).await == 0).await;
    let mut publisher = second.publish(&nodes[1].1).await;
    publisher.send(Encoding::Bytes, b"there is room").await.unwrap();
    assert_eq!(next(&mut subscription).await.body[..], b"there is room"[..]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_certificate_until_the_end_of_time_does_not_stop_the_clock() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let papers = Credentials::new();
    let (_port, link) = papers.bare_link(&switch, 0).await;
    papers.attach(&switch, (&link, 0), u64::MAX).await;
    // The RIB's timer now sleeps forever, or until an earlier deadline is added.
    let card = &papers.card;
    let says = Advert {
        op: AdvertOp::Publish,
        name: card.name(),
        entity: papers.robot.name(),
        switch: switch.name(),
        serial: 1,
        lifetime: 3,
        box_key: papers.robot.box_public(),
    };
    let advert = issue(papers.robot.key(), &says).unwrap();
    let request =
        EntityRequest::Advertise { proof: card.proof(), ad_cert: papers.ad_cert(), advert, everywhere: false };
    let done = link.request(&Request::Entity(request)).await.unwrap();
    assert!(matches!(done, Response::Peers(_)), "{done:?}");
    assert_eq!(switch.status().await["rib"]["names"], 1);
    wait("the name to end by itself", async || switch.status().await["rib"]["names"] == 0).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_endpoint_that_the_rib_forgets_attaches_again_by_each_of_its_links() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let papers = Credentials::new();
    let (_first_port, first) = papers.bare_link(&switch, 0).await;
    let (_second_port, second) = papers.bare_link(&switch, 1).await;
    let not_after = unix_seconds() + 4;
    for at in [(&first, 0), (&second, 1)] {
        papers.attach(&switch, at, not_after).await;
    }
    for (link, lane) in [(&first, 0), (&second, 1)] {
        let request = tokio::time::timeout(TIMEOUT, link.accept_request()).await.expect("told in time");
        let (Request::Detach { entity, .. }, responder) = request.expect("a live link") else {
            panic!("another request")
        };
        assert_eq!(entity, papers.robot.name());
        papers.attach(&switch, (link, lane), unix_seconds() + 3600).await;
        responder.respond(Response::Done).await.unwrap();
    }
    switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_switch_that_is_not_listed_gets_no_link_nor_does_a_copy_of_this_one() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let stranger = Identity::generate("switch").unwrap();
    let copy = Identity::load_or_generate(&folder.path().join("s1.pem"), "switch").unwrap();
    for (identity, needle) in [(stranger, "is not listed in the neighbours"), (copy, "has the key of this switch")] {
        let port = Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::switch(identity, LinkIds::new())).unwrap();
        let to = LinkAddr::udp(switch.udp_addr().unwrap());
        // The switch may close the link before it is established; then there is no reason.
        let refused = async || match port.dial(to, Some(switch.name())).await {
            Ok(link) => link.closed().await.contains(needle),
            Err(_) => false,
        };
        wait(needle, refused).await;
    }
    assert_eq!(switch.status().await["links"], serde_json::json!([]));
}

#[tokio::test(flavor = "multi_thread")]
async fn writers_of_a_name_may_send_to_it_and_nobody_else() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let at = switch.udp_addr().unwrap();
    let first = Credentials::new();
    let second = Credentials { robot: Identity::generate("proxy").unwrap(), ..first.clone() };
    let stranger = Credentials { robot: Identity::generate("proxy").unwrap(), ..first.clone() };

    let reader = first.reader(at).await;
    let mut subscription = first.subscribe(&reader).await;
    let nodes = [first.writer(at).await, second.writer(at).await];
    let mut publishers = [first.publish(&nodes[0]).await, second.publish(&nodes[1]).await];
    for (publisher, papers) in publishers.iter_mut().zip([&first, &second]) {
        publisher.send(Encoding::Bytes, b"both").await.unwrap();
        assert_eq!(next(&mut subscription).await.writer, papers.robot.name());
    }

    let (port, link) = stranger.bare_link(&switch, 0).await;
    // This side has the link before the switch has it.
    let linked = async || switch.status().await["links"].as_array().is_some_and(|links| links.len() == 4);
    wait("the stranger's link", linked).await;
    let (topic, own) = (first.card.name(), stranger.robot.name());
    for (count, (reason, source)) in (1..).zip([("drop_not_permitted", own), ("drop_source", first.robot.name())]) {
        let mut header = Header::data(topic, source, 0);
        hop::stamp(&mut header, &link.entry(PORT_USERSPACE), count);
        let frame = OutFrame { to: link.addr(), head: header.as_bytes(), body: &[] };
        assert_eq!(port.data().send_batch([frame; 2]).sent, 2);
        let counted = async || {
            let counters = switch.status().await["counters"].clone();
            (&counters[reason], &counters["drop_replayed"]) == (&1.into(), &count.into())
        };
        wait(reason, counted).await;
    }

    drop(publishers);
    wait("the name to be gone", async || fib_names(&switch).await == 0).await;
    switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_has_any_number_of_subscribers_and_all_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let papers = Credentials::new();
    let mut nodes = Vec::new();
    for _ in 0..3 {
        let reader = Credentials { cloud: Identity::generate("proxy").unwrap(), ..papers.clone() };
        let node = reader.reader(switch.udp_addr().unwrap()).await;
        let subscription = reader.subscribe(&node).await;
        nodes.push((reader.cloud.name(), node, subscription));
    }
    let query = async |after| nodes[0].1.query(papers.card.name().into(), after).await.unwrap();
    let (records, more) = query(None).await;
    let mut expected: Vec<Name> = nodes.iter().map(|(name, ..)| *name).collect();
    expected.sort();
    assert_eq!(records.iter().map(|record| record.entity.name().unwrap()).collect::<Vec<_>>(), expected);
    assert!(!more);
    let (rest, _) = query(records[1].key().ok()).await;
    assert_eq!(rest.len(), 1);
    switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn only_what_a_switch_states_itself_becomes_topology() {
    let folder = tempfile::tempdir().unwrap();
    let (near, far) = (Identity::generate("switch").unwrap(), Identity::generate("switch").unwrap());
    let mut config = config(folder.path(), "s1");
    let place = NeighbourAddress { switch: near.name(), via: Via::Udp("127.0.0.1:9".parse().unwrap()) };
    config.neighbours = vec![Neighbour { address: place, cost: None, dial: false, parent: false, tls: None }];
    let switch = start(config).await.unwrap();
    let to = LinkAddr::udp(switch.udp_addr().unwrap());
    let port = |config| Port::udp("127.0.0.1:0".parse().unwrap(), &config).unwrap();
    let neighbour = port(PortConfig::switch(near.clone(), LinkIds::new()));
    let link = neighbour.dial(to, Some(switch.name())).await.unwrap();
    let claims = |of: &Identity, neighbours: &[Name]| {
        let neighbours = neighbours.iter().collect::<std::collections::BTreeSet<_>>();
        let neighbours = neighbours.into_iter().map(|name| (*name, 5)).collect();
        LinkState {
            switch: of.name(),
            run: 1,
            number: 1,
            bit: None,
            neighbours,
            silent: 0,
            rib: false,
            borders: vec![],
            lifetime: 60,
        }
    };
    let flooded = |by: &Identity, claims: &LinkState| Flooded {
        proof: by.proof(),
        state: issue(by.key(), claims).unwrap(),
        expires_in: 60,
    };
    let flood = async |state| link.request(&Request::Flood { states: vec![state] }).await.unwrap();
    let known = async |switches: u64, reached: u64| {
        let topology = switch.status().await["topology"].clone();
        topology["switches"] == switches && topology["reached"] == reached
    };
    let pass = async |to: Name, hops, request| {
        let request = Request::Onward { to, hops, request: Box::new(request) };
        match link.request(&request).await.unwrap() {
            Response::Refused(refusal) => refusal.reason,
            response => format!("{response:?}"),
        }
    };
    let report =
        |of: &Identity| Request::Report { switch: of.proof(), attached: vec![], own_bit: None, membership: None };
    let refused = pass(switch.name(), MAX_HOPS, report(&near)).await;
    assert!(refused.contains("not on the map of switch"), "{refused}");
    let lies = flood(flooded(&near, &claims(&far, &[near.name()]))).await;
    assert!(matches!(&lies, Response::Refused(r) if r.reason.contains("wrong name")), "{lies:?}");
    assert!(matches!(flood(flooded(&near, &claims(&near, &[switch.name(), far.name()]))).await, Response::Done));
    wait("the neighbour to be reached", async || known(2, 2).await).await;
    let taken = pass(switch.name(), MAX_HOPS, report(&near)).await;
    assert!(taken.starts_with("Reported"), "{taken}");
    let refused = pass(switch.name(), MAX_HOPS, report(&far)).await;
    assert!(refused.contains("not on the map of the RIB"), "{refused}");
    let direct = link.request(&report(&near)).await.unwrap();
    assert!(matches!(&direct, Response::Refused(r) if r.reason.contains("with whom it is for")), "{direct:?}");
    assert!(matches!(flood(flooded(&far, &claims(&far, &[]))).await, Response::Done));
    wait("the other one to be known", async || known(3, 2).await).await;
    assert!(known(3, 2).await, "it does not state the link");
    let (newer, back) = (2, claims(&far, &[near.name()]));
    assert!(matches!(flood(flooded(&far, &LinkState { number: newer, ..back })).await, Response::Done));
    wait("the other one to be reached", async || known(3, 3).await).await;
    let taken = pass(switch.name(), MAX_HOPS, report(&far)).await;
    assert!(taken.starts_with("Reported"), "behind its neighbour: {taken}");
    for (to, hops, needle) in [
        (far.name(), MAX_HOPS, "which asks it"),
        (far.name(), 0, "no hop is left"),
        (Name::from_bytes([1; 32]), MAX_HOPS, "knows no path"),
    ] {
        let refused = pass(to, hops, report(&near)).await;
        assert!(refused.contains(needle), "{refused}");
    }

    let (_port, endpoint) = Credentials::new().bare_link(&switch, 0).await;
    let states = vec![flooded(&far, &LinkState { number: 9, ..claims(&far, &[]) })];
    let refused = endpoint.request(&Request::Flood { states }).await.unwrap();
    assert!(matches!(&refused, Response::Refused(r) if r.reason.contains("an endpoint may not")), "{refused:?}");
    link.close("done");
    wait("nobody to be reached", async || known(3, 1).await).await;
    switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn where_no_switch_has_the_rib_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let chain = Chain::new(folder.path());
    let switches = [start(chain.config(0)).await.unwrap(), start(chain.config(1)).await.unwrap()];
    for switch in &switches {
        wait("the other one to be reached", async || switch.status().await["topology"]["reached"] == 2).await;
    }
    let papers = Credentials::new();
    let mut config = NodeConfig::new(papers.robot.clone(), format!("udp://{}", chain.addrs[0]).parse().unwrap());
    config.connect_timeout = Duration::from_secs(5);
    let error = Node::connect(config).await.err().unwrap();
    assert!(error.to_string().contains("no way to the RIB"), "{error}");
    let control = switches[0].status().await["control"].clone();
    assert_eq!((&control["rib"], &control["ready"]), (&Value::Null, &false.into()));
    assert!(control["reason"].as_str().unwrap().contains("no switch that it knows"), "{control}");
}

/// Sends a message repeatedly until it arrives, because links and routes may still be recovering.
async fn exchange(publisher: &mut Publisher, subscription: &mut Subscription, what: &str) {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        assert!(Instant::now() < deadline, "no message {what}");
        let _ = publisher.send(Encoding::Bytes, what.as_bytes()).await;
        let waiting = tokio::time::timeout(Duration::from_millis(100), subscription.recv()).await;
        if let Ok(Some(message)) = waiting
            && message.body == what.as_bytes()
        {
            return;
        }
    }
}

async fn next(subscription: &mut Subscription) -> gdp_e2e::seal::Message {
    tokio::time::timeout(TIMEOUT, subscription.recv()).await.expect("a message in time").expect("a live subscription")
}

async fn fib_names(switch: &Running) -> u64 {
    switch.status().await["fib"]["names"].as_u64().unwrap()
}

/// Keys and certificates for one name.
#[derive(Clone)]
struct Credentials {
    owner: SigningKey,
    card: NameCard,
    robot: Identity,
    cloud: Identity,
}

impl Credentials {
    fn new() -> Self {
        let owner = SigningKey::generate().unwrap();
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None).unwrap();
        Self { owner, card, robot: Identity::generate("proxy").unwrap(), cloud: Identity::generate("proxy").unwrap() }
    }

    async fn writer(&self, at: SocketAddr) -> Node {
        connect(&self.robot, at).await
    }

    async fn reader(&self, at: SocketAddr) -> Node {
        connect(&self.cloud, at).await
    }

    /// Returns the same two entities with another name.
    fn with_another_name(&self) -> Self {
        let card = NameCard::create(self.owner.verify_key(), "topic", "/chatter", "T", None).unwrap();
        Self { card, ..self.clone() }
    }

    /// Attaches the robot's link.
    async fn attach(&self, switch: &Running, (link, lane): (&Link, u8), not_after: u64) {
        let claims = RtCert { entity: self.robot.name(), switch: switch.name(), not_after };
        let rt_cert = issue(self.robot.key(), &claims).unwrap();
        let request = EntityRequest::Attach { rt_cert, resumes: true, lane };
        let attached = link.request(&Request::Entity(request)).await.unwrap();
        assert!(matches!(attached, Response::Attached { .. }), "{attached:?}");
    }

    /// Returns an unattached link of the robot. Dropping the returned port closes the link.
    async fn bare_link(&self, switch: &Running, lane: u8) -> (Port, Link) {
        let config = PortConfig { lane, ..PortConfig::endpoint(self.robot.clone()) };
        let port = Port::udp("127.0.0.1:0".parse().unwrap(), &config).unwrap();
        let link = port.dial(LinkAddr::udp(switch.udp_addr().unwrap()), Some(switch.name())).await.unwrap();
        (port, link)
    }

    async fn publish(&self, node: &Node) -> Publisher {
        self.try_publish(node).await.unwrap()
    }

    async fn try_publish(&self, node: &Node) -> Result<Publisher, NodeError> {
        node.publish(self.card.proof(), self.ad_cert(), PublishOptions::reliable()).await
    }

    fn ad_cert(&self) -> Issued<AdCert> {
        let cert = AdCert {
            name: self.card.name(),
            entity: self.robot.name(),
            scope: vec![],
            serial: 1,
            not_before: 0,
            not_after: unix_seconds() + 3600,
        };
        issue(&self.owner, &cert).unwrap().into()
    }

    async fn subscribe(&self, node: &Node) -> Subscription {
        node.subscribe(self.card.proof(), self.grant(), SubscribeOptions::reliable()).await.unwrap()
    }

    fn grant(&self) -> Reading {
        let grant = ReadGrant {
            name: self.card.name(),
            to: Grantee::Entity(self.cloud.name()),
            serial: 1,
            not_before: 0,
            not_after: unix_seconds() + 3600,
        };
        issue(&self.owner, &grant).unwrap().into()
    }
}

async fn connect(identity: &Identity, at: SocketAddr) -> Node {
    let target = format!("udp://{at}").parse().unwrap();
    Node::connect(NodeConfig::new(identity.clone(), target)).await.unwrap()
}

fn unix_seconds() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs()
}
