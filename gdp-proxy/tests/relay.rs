//! A proxy that carries others, as a program, on loopback UDP and without root: a node that knows
//! no other address than the relay's talks with one at the switch.
//!
//! ```text
//!    near ── relay (in the proxy's process) ── hub (switch, RIB) ── far
//!                 the proxy itself ─────────────┘
//! ```

mod hub;
#[path = "../../gdp-ctl/tests/integration/ports.rs"]
mod ports;

use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use gdp::unstable::{LinkState, Node, NodeConfig, PublishOptions, Publisher, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, MemberCert, Membership, ReadGrant, issue};
use gdp_core::domain::{CredentialFiles, Credentials};
use gdp_core::identity::{Identity, SigningKey};
use gdp_daemon::config::{DomainConfig, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve::{Running, start};
use gdp_e2e::seal::Encoding;
use gdp_tests::dds_domain::lease;
use gdp_tests::programs::own;
use gdp_wire::Name;
use tokio::time::timeout;

/// How long anything may take on a busy machine.
const TIMEOUT: Duration = Duration::from_secs(60);

#[tokio::test(flavor = "multi_thread")]
async fn a_node_that_reaches_only_a_relay_is_carried_both_ways_and_again_when_the_relay_is_back() {
    carry(&Site::start(true).await).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_domain_its_switch_has_to_list_the_relay() {
    carry(&Site::start(false).await).await;
}

async fn carry(site: &Site) {
    let mut proxy = site.proxy();
    let [near, far] = [(); 2].map(|()| Identity::generate("proxy").unwrap());
    let near_node = site.attach(&near, site.relay_addr).await;
    let far_node = site.attach(&far, site.hub_addr).await;
    assert_eq!(near_node.switch().unwrap(), site.relay);
    assert_eq!(far_node.switch().unwrap(), site.hub.name());

    let (mut out, mut heard_far) = pair((&near, &near_node), (&far, &far_node)).await;
    let (mut back, mut heard_near) = pair((&far, &far_node), (&near, &near_node)).await;
    say(&mut out, &mut heard_far, &near, 1).await;
    say(&mut back, &mut heard_near, &far, 2).await;

    proxy.kill();
    let is_up = || near_node.links()[0].state == LinkState::Up;
    wait("the link to be down", || !is_up()).await;
    let _proxy = site.proxy();
    wait("the link to be up", is_up).await;
    say(&mut out, &mut heard_far, &near, 3).await;
    say(&mut back, &mut heard_near, &far, 4).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_relay_that_is_no_switch_of_the_domain_is_refused_with_the_remedy() {
    let site = Site::start(true).await;
    fs::write(site.file("relay.member"), site.membership(site.relay, "proxy").to_pem()).unwrap();
    let output = site.command().arg("--check").output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    for part in ["relay.membership: ", "its role is proxy", &format!("domain admit --key DOMAIN.pem {}", site.relay)] {
        assert!(said.contains(part), "{said}");
    }

    let (files, unnamed) = (site.file("robot.yaml"), format!(", switch: {}", site.hub.name()));
    fs::write(&files, fs::read_to_string(&files).unwrap().replace(&unnamed, "")).unwrap();
    let output = site.command().arg("--check").output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("links: the relay needs a switch to pass on to"), "{said}");
}

/// A message that arrives, as `writer`'s.
async fn say(publisher: &mut Publisher, subscription: &mut Subscription, writer: &Identity, body: u8) {
    publisher.send(Encoding::Bytes, &[body]).await.unwrap();
    let message = timeout(TIMEOUT, subscription.recv()).await.expect("in time").expect("a message");
    assert_eq!((message.body.to_vec(), message.writer), (vec![body], writer.name()));
}

/// A name of its own that one publishes and the other reads.
async fn pair(writer: (&Identity, &Node), reader: (&Identity, &Node)) -> (Publisher, Subscription) {
    let owner = SigningKey::generate().unwrap();
    let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None).unwrap();
    let (name, not_before, not_after) = (card.name(), 0, tomorrow());
    let (entity, scope) = (writer.0.name(), vec![]);
    let ad_cert = AdCert { name, entity, scope, serial: 1, not_before, not_after };
    let grant = ReadGrant { name, to: Grantee::Entity(reader.0.name()), serial: 2, not_before, not_after };
    let (ad_cert, grant) = (issue(&owner, &ad_cert).unwrap(), issue(&owner, &grant).unwrap());
    let subscription = reader.1.subscribe(card.proof(), grant.into(), SubscribeOptions::reliable()).await.unwrap();
    let publisher = writer.1.publish(card.proof(), ad_cert.into(), PublishOptions::reliable()).await.unwrap();
    (publisher, subscription)
}

/// A switch, in a domain or not, and the files of a proxy that is to relay.
struct Site {
    folder: tempfile::TempDir,
    domain: Identity,
    in_domain: bool,
    hub: Running,
    hub_addr: SocketAddr,
    relay: Name,
    relay_addr: SocketAddr,
}

impl Site {
    async fn start(in_domain: bool) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = |file: &str| folder.path().join(file);
        let domain = Identity::generate("domain").unwrap();
        let card = NameCard::new(domain.key().verify_key(), domain.metadata().clone()).unwrap();
        card.save_new(&path("domain.card")).unwrap();
        let entity = |file: &str, kind| Identity::load_or_generate(&path(file), kind).unwrap().name();
        let (hub, relay, proxy) =
            (entity("hub.pem", "switch"), entity("relay.pem", "switch"), entity("robot.pem", "proxy"));
        for (file, entity, role) in
            [("hub.member", hub, "rib"), ("relay.member", relay, "switch"), ("robot.member", proxy, "proxy")]
        {
            fs::write(path(file), membership(&domain, entity, role).to_pem()).unwrap();
        }
        let relay_addr = ports::free_addr();
        let mut hub = hub::config(folder.path(), Some(hub_domain(folder.path())));
        let mut member = "domain: {card: domain.card, membership: robot.member}\n";
        if !in_domain {
            let place = NeighbourAddress { switch: relay, via: Via::Udp(relay_addr) };
            hub.neighbours = vec![Neighbour { address: place, cost: None, dial: false, parent: false, tls: None }];
            (hub.domain, member) = (None, "");
        }
        let hub = start(hub).await.unwrap();
        let hub_addr = hub.udp_addr().unwrap();
        let config = format!(
            "version: 1\nidentity: robot.pem\nlinks: [{{to: 'udp://{hub_addr}', switch: {}}}]\ngraphs: {{a: \
             {{domain_id: {}}}}}\n{member}\
             relay: {{udp: '{relay_addr}'}}\n",
            hub.name(),
            lease()
        );
        fs::write(path("robot.yaml"), config).unwrap();
        Self { folder, domain, in_domain, hub, hub_addr, relay, relay_addr }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self) -> Command {
        let mut command = own(env!("CARGO_BIN_EXE_gdp-proxy"));
        command.arg("--config").arg(self.file("robot.yaml")).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    fn proxy(&self) -> Program {
        Program(self.command().stdout(Stdio::null()).stderr(Stdio::inherit()).spawn().unwrap())
    }

    fn membership(&self, entity: Name, role: &str) -> Membership {
        membership(&self.domain, entity, role)
    }

    /// As a member of the domain, if there is one: a relay carries no others.
    async fn attach(&self, identity: &Identity, to: SocketAddr) -> Node {
        let papers = Credentials { membership: self.membership(identity.name(), "proxy"), peers: vec![] };
        let target = format!("udp://{to}").parse().unwrap();
        let config =
            NodeConfig { credentials: self.in_domain.then_some(papers), ..NodeConfig::new(identity.clone(), target) };
        let deadline = Instant::now() + TIMEOUT;
        loop {
            match Node::connect(config.clone()).await {
                Ok(node) => return node,
                // The relay may not be there yet, or have no way to the RIB.
                Err(error) => assert!(Instant::now() < deadline, "{error}"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }
}

fn membership(domain: &Identity, entity: Name, role: &str) -> Membership {
    let (serial, not_before, not_after, role) = (1, 0, tomorrow(), role.to_owned());
    let cert = MemberCert { domain: domain.name(), entity, role, serial, not_before, not_after };
    Membership::issue(domain, &cert).unwrap()
}

/// What makes the hub a member of the domain.
fn hub_domain(folder: &Path) -> DomainConfig {
    let path = |file: &str| folder.join(file);
    let files = CredentialFiles { card: path("domain.card"), membership: path("hub.member"), peers: vec![] };
    DomainConfig { files, members_only: true, trace: Default::default() }
}

/// A program that ends with the test.
struct Program(Child);

impl Program {
    fn kill(&mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended by itself.
        _ = self.0.kill();
        _ = self.0.wait();
    }
}

async fn wait(what: &str, condition: impl Fn() -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !condition() {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

fn tomorrow() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs() + 86400
}
