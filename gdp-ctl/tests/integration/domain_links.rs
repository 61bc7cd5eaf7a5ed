//! Daemons and nodes as members of domains, on loopback UDP, without root. The tests cover which
//! links are accepted, the reasons that both sides log, and how links end or are renewed.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use crate::member::{Domain, LONG, Place, Settings, now};
use crate::switch::wait;
use gdp::unstable::{Node, NodeConfig, NodeError};
use gdp_core::card::NameCard;
use gdp_core::cert::{Invite, Membership, PeerCert, Revocation, Signed, issue};
use gdp_core::domain::{Credentials, Token};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::link_target::LinkTarget;
use gdp_ctl::client::Client;
use gdp_daemon::serve::Running;
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_proto::admin::Request;
use gdp_proto::control::{EntityRequest, Response};
use gdp_wire::Name;
use serde_json::Value;

#[tokio::test(flavor = "multi_thread")]
async fn a_switch_gets_links_with_members_and_everybody_else_a_reason() {
    let (home, away, log) = (Domain::new(1), Domain::new(2), log());
    let hub = Place::new("hub");
    let rights = home.peer(&away, "peering", LONG);
    let hub_running = hub.member(&home, "border", LONG).peers(&[&rights]).rib().start().await;

    let ends = |spoke: &Place, what: &str| {
        let (spoke, what) = (format!("{:#}", spoke.name), what.to_owned());
        let lines = log.lines();
        let here =
            lines.iter().any(|line| line.contains("refused a link") && line.contains(&what) && line.contains(&spoke));
        let there = lines.iter().any(|line| line.contains("no link") && line.contains(&what));
        here && there
    };

    let member = Place::new("member");
    let running = member.member(&home, "switch", LONG).dials(&hub).start().await;
    wait("the member's link", async || standing(&hub_running, &member).await == "member").await;
    wait("the hub's link", async || standing(&running, &hub).await == "member").await;

    let stranger = Place::new("stranger");
    let _stranger = stranger.alone().dials(&hub).start().await;
    let why = format!("{:#} shows no membership", stranger.name);
    wait("both to say that a stranger is none", async || ends(&stranger, &why)).await;
    let status = hub_running.status().await;
    let refused = status["refused"].as_array().unwrap();
    let refused = refused.iter().find(|it| it["peer"] == stranger.name.to_string()).expect("the refused stranger");
    assert!(refused["what"] == "link" && refused["count"].as_u64() > Some(0), "{refused}");
    assert!(refused["reason"].as_str().unwrap().contains("shows no membership"), "{refused}");

    let expired = Place::new("expired");
    let _expired = expired.member(&home, "switch", -5).dials(&hub).start().await;
    let why = format!("serial {}", expired.serial());
    wait("both to say what has expired", async || {
        let lines = log.lines();
        let of = |line: &&String| line.contains(&why) && line.contains("expired 20");
        lines.iter().filter(of).filter(|line| line.contains("refused a link")).count() >= 2
    })
    .await;

    // The hub knows the revocation. The switch does not, and learns it from the hub.
    let revoked = Place::new("revoked");
    let settings = revoked.member(&home, "switch", LONG).dials(&hub);
    home.revoke(&hub, 1, &[revoked.serial()]).await;
    let _revoked = settings.start().await;
    let why = format!("serial {}", revoked.serial());
    wait("both to say what is revoked", async || ends(&revoked, &why)).await;
    let said = log.lines().into_iter().find(|line| line.contains("no link") && line.contains(&why)).unwrap();
    assert!(
        said.contains("by revocation 1") && said.contains("floor 0") && said.contains("have a new one issued"),
        "{said}"
    );

    let robot = Place::new("robot");
    let _robot = robot.member(&home, "arm", LONG).dials(&hub).start().await;
    let why = format!("{:#} is arm in domain", robot.name);
    wait("both to say that a robot is no switch", async || ends(&robot, &why)).await;

    // A border of another domain. First only the hub's domain has issued a PeerCert, then both
    // domains have.
    let foreign = Place::new("foreign");
    let running = foreign.member(&away, "border", LONG).dials(&hub).start().await;
    let why = format!("which domain {:#} does not know", away.identity.name());
    let here =
        format!("domain {:#} has not issued a PeerCert to domain {:#}", away.identity.name(), home.identity.name());
    // Each side verifies the other. The dialling side may receive the hub's reason before its own
    // check has finished.
    wait("both to say why they do not peer", async || {
        let lines = log.lines();
        lines.iter().any(|line| line.contains("refused a link") && line.contains(&here))
            && lines.iter().any(|line| line.contains("no link") && (line.contains(&why) || line.contains(&here)))
    })
    .await;
    assert_eq!(standing(&hub_running, &foreign).await, "none");
    running.stop().await;
    let peering = away.peer(&home, "peering,transit", LONG);
    let running = foreign.member(&away, "border", LONG).peers(&[&peering]).dials(&hub).rib().start().await;
    wait("the border link", async || standing(&hub_running, &foreign).await == "border").await;
    wait("its other end", async || standing(&running, &hub).await == "border").await;
    wait("its member to report", async || hub_running.status().await["rib"]["switches"].as_u64() >= Some(2)).await;
    // The border link does not carry traffic within one domain.
    let (rib, name) = (hub_running.status().await, foreign.name.to_string());
    assert_eq!(rib["rib"]["switches"], 2, "the hub and its member: {rib}");
    let link = rib["links"].as_array().unwrap().iter().find(|link| link["peer"] == name.as_str()).unwrap();
    assert_eq!((&link["domain"], &link["role"]), (&away.identity.name().to_string().into(), &"border".into()));

    // Revoking the PeerCert closes the border link immediately, and both sides log the reason.
    let serial = rights.claims_unverified().unwrap().serial;
    home.revoke(&hub, 2, &[revoked.serial(), serial]).await;
    let why = format!("the PeerCert with serial {serial}");
    wait("the border link to be closed", async || standing(&hub_running, &foreign).await == "none").await;
    wait("both to say why", async || {
        let lines = log.lines();
        let has = |what: &str| lines.iter().any(|line| line.contains(what) && line.contains(&why));
        has("closing a link") && has("closed by the peer")
    })
    .await;
    assert_eq!(standing(&hub_running, &member).await, "member");
}

#[tokio::test(flavor = "multi_thread")]
async fn links_end_with_what_they_rest_on_unless_it_is_renewed() {
    let (home, log) = (Domain::new(3), log());
    let (hub, spoke) = (Place::new("hub"), Place::new("spoke"));
    let hub_running = hub.member(&home, "rib", LONG).rib().start().await;
    let running = spoke.member(&home, "switch", 8).dials(&hub).start().await;
    wait("the link", async || standing(&hub_running, &spoke).await == "member").await;
    let (id, ends) = link_to(&hub_running, &spoke).await.map(|link| (link["id"].clone(), until(&link))).unwrap();

    // A renewal before expiry: the same link continues until the new expiry.
    spoke.renew(&home, "switch", 14);
    wait("the renewal to be taken", async || {
        link_to(&hub_running, &spoke).await.is_some_and(|link| until(&link) > ends)
    })
    .await;
    let link = link_to(&hub_running, &spoke).await.unwrap();
    assert_eq!(link["id"], id, "no new link");
    wait("the old one's end", async || now() > ends as i64 + 1).await;
    assert_eq!(link_to(&hub_running, &spoke).await.unwrap()["id"], id);

    // Expiry closes the link.
    let ends = until(&link) as i64;
    wait("the link to be closed", async || link_to(&hub_running, &spoke).await.is_none()).await;
    assert!((0..=10).contains(&(now() - ends)), "{} after its end", now() - ends);
    let why = format!("serial {}", spoke.serial());
    wait("both to say why", async || {
        log.lines().iter().filter(|line| line.contains(&why) && line.contains("expired 20")).count() >= 2
    })
    .await;
    // A renewal after expiry: the daemon gets a new link without a restart.
    spoke.renew(&home, "switch", LONG);
    wait("another link", async || standing(&hub_running, &spoke).await == "member").await;
    assert_ne!(link_to(&hub_running, &spoke).await.unwrap()["id"], id);
    // An invalid file is ignored.
    std::fs::write(spoke.file("membership"), "nonsense").unwrap();
    wait("the complaint", async || log.lines().iter().any(|line| line.contains("is not taken, what was there"))).await;
    assert_eq!(standing(&hub_running, &spoke).await, "member");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_domain_takes_back_reaches_all_its_switches_and_stays_so() {
    let home = Domain::new(4);
    let (hub, mid, leaf) = (Place::new("hub"), Place::new("mid"), Place::new("leaf"));
    let hub_running = hub.member(&home, "rib", LONG).rib().start().await;
    let mid_running = mid.member(&home, "switch", LONG).dials(&hub).start().await;
    let _leaf = leaf.member(&home, "switch", LONG).dials(&mid).start().await;
    wait("the leaf's link", async || standing(&mid_running, &leaf).await == "member").await;
    wait("the way to the RIB", async || standing(&mid_running, &hub).await == "member").await;

    home.revoke(&hub, 1, &[leaf.serial()]).await;
    wait("the leaf's link to be closed", async || standing(&mid_running, &leaf).await == "none").await;
    assert_eq!(standing(&mid_running, &hub).await, "member");

    // The revocation also applies after a daemon restart, without being sent again.
    hub_running.stop().await;
    mid_running.stop().await;
    wait("the address to be free", async || UdpSocket::bind(mid.addr).is_ok()).await;
    // The leaf may dial before `start` returns. A second refusal in a minute has no line.
    let before = log().lines().len();
    let mid_running = mid.settings(Some(&home)).dials(&hub).start().await;
    let known = &mid_running.status().await["domain"]["revocations"];
    assert_eq!((&known[0]["number"], known.as_array().unwrap().len()), (&1.into(), 1), "{known}");
    let refused = format!("serial {}", leaf.serial());
    wait("the leaf to be refused again", async || {
        log().lines()[before..].iter().any(|line| line.contains("refused a link") && line.contains(&refused))
    })
    .await;
    assert_eq!(standing(&mid_running, &leaf).await, "none");
    // A revocation with a lower number is refused, and so is another domain's.
    let error = home.try_revoke(&mid, 0, &[]).unwrap_err();
    assert!(error.contains("rolled back"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_kept_of_a_domain_is_not_said_to_be_done() {
    let home = Domain::new(6);
    let hub = Place::new("hub");
    let _hub = hub.member(&home, "rib", LONG).rib().start().await;
    // A file cannot replace a folder that is not empty.
    let [revocations, invitations] =
        ["domain-revocations", "invitations"].map(|kind| hub.file("switch").with_extension(kind));
    std::fs::create_dir_all(revocations.join("in the way")).unwrap();
    for _ in 0..2 {
        let error = home.try_revoke(&hub, 1, &[7]).unwrap_err();
        assert!(error.contains("taken in, but not kept") && error.contains("domain-revocations"), "{error}");
    }
    std::fs::remove_dir_all(&revocations).unwrap();
    home.revoke(&hub, 1, &[7]).await;
    assert!(revocations.is_file() && invitations.is_file());

    // If the RIB forgot a used invitation, the invitation would admit another entity after a
    // restart.
    std::fs::remove_file(&invitations).unwrap();
    std::fs::create_dir_all(invitations.join("in the way")).unwrap();
    let token = home.invite("arm", &hub);
    let robot = Identity::generate("proxy").unwrap();
    let membership = token.admit(robot.name(), 0, now() as u64 * 1_000_000_000).unwrap();
    let papers = || Some(Credentials { membership: membership.clone(), peers: vec![] });
    let error = attach(&robot, papers(), hub.addr).await.err().unwrap().to_string();
    assert!(error.contains("taken in, but not kept") && error.contains("invitations"), "{error}");
    std::fs::remove_dir_all(&invitations).unwrap();
    attach(&robot, papers(), hub.addr).await.unwrap().close().await;
    assert!(invitations.is_file());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_invitation_admits_the_first_that_the_rib_sees() {
    let (home, log) = (Domain::new(5), log());
    let (hub, mid, first, second) = (Place::new("hub"), Place::new("mid"), Place::new("first"), Place::new("second"));
    let hub_running = hub.member(&home, "rib", LONG).rib().start().await;
    let mid_running = mid.member(&home, "switch", LONG).dials(&hub).start().await;
    wait("the way to the RIB", async || mid_running.status().await["control"]["ready"] == true).await;
    let token = home.invite("switch", &mid);
    let line = token.to_line();
    let token = Token::from_line(&line).unwrap();
    let first_running = first.joined(&token).dials(&mid).start().await;
    wait("the first to be taken", async || standing(&mid_running, &first).await == "member").await;
    wait("it to be taken by both", async || standing(&first_running, &mid).await == "member").await;
    let _second = second.joined(&token).dials(&mid).start().await;
    let why = format!("the invitation with serial {} has admitted {:#}", first.serial(), first.name);
    let said = |log: &Log, how: &str| log.lines().iter().any(|line| line.contains(how) && line.contains(&why));
    wait("the second to be refused", async || said(&log, "refused a link")).await;
    wait("it to hear why", async || said(&log, "closed by the peer")).await;
    assert_eq!(standing(&mid_running, &second).await, "none");

    // Invitations of robots work in the same way.
    let token = home.invite("arm", &mid);
    let [robot, thief] = ["proxy"; 2].map(|kind| Identity::generate(kind).unwrap());
    let papers = |robot: &Identity| {
        let membership = token.admit(robot.name(), 0, now() as u64 * 1_000_000_000).unwrap();
        Some(Credentials { membership, peers: vec![] })
    };
    let node = attach(&robot, papers(&robot), mid.addr).await.unwrap();
    assert_eq!(link_of(&mid_running, robot.name()).await.unwrap()["relationship"], "member");
    node.close().await;
    let error = attach(&thief, papers(&thief), mid.addr).await.err().unwrap().to_string();
    assert!(error.contains("closed by the peer") && error.contains("has admitted"), "{error}");

    // The RIB and the switch both remember the invitation. Without the RIB, the admitted entity
    // gets its link again.
    hub_running.stop().await;
    wait("the address to be free", async || UdpSocket::bind(hub.addr).is_ok()).await;
    mid_running.stop().await;
    wait("the address to be free", async || UdpSocket::bind(mid.addr).is_ok()).await;
    let mid_running = mid.settings(Some(&home)).dials(&hub).start().await;
    wait("the first again", async || standing(&mid_running, &first).await == "member").await;
    let hub_running = hub.settings(Some(&home)).rib().start().await;
    assert_eq!(hub_running.status().await["domain"]["invitations_used"], 2);
    let before = log.lines().len();
    wait("the second to be refused again", async || {
        log.lines()[before..].iter().any(|line| line.contains("closed by the peer") && line.contains(&why))
    })
    .await;
}

/// QUIC holds back the close of a link while probes of the MTU fill the congestion window. With the
/// window of RFC 9002, one in ten was only reset on a busy machine.
#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_refused_learns_why_each_time() {
    let (home, hub) = (Domain::new(8), Place::new("hub"));
    let mut settings = hub.member(&home, "rib", LONG).rib();
    settings.0.domain.as_mut().unwrap().members_only = true;
    let _running = settings.start().await;
    for _ in 0..200 {
        let stranger = PortConfig::endpoint(Identity::generate("proxy").unwrap());
        let port = Port::udp("127.0.0.1:0".parse().unwrap(), &stranger).unwrap();
        let why = match port.dial(LinkAddr::udp(hub.addr), None).await {
            Ok(link) => link.closed().await,
            Err(error) => error.to_string(),
        };
        assert!(why.contains("shows no membership"), "{why}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_attach_as_members_or_visitors_and_to_their_own_kind_only() {
    let (home, away) = (Domain::new(6), Domain::new(7));
    let (hub, open) = (Place::new("hub"), Place::new("open"));
    let mut settings = hub.member(&home, "rib", LONG).peers(&[&home.peer(&away, "visit", LONG)]).rib();
    settings.0.domain.as_mut().unwrap().members_only = true;
    let hub_running = settings.start().await;
    let open_running = open.member(&away, "rib", LONG).rib().start().await;

    // Attach without a membership.
    let stranger = Identity::generate("proxy").unwrap();
    let error = attach(&stranger, None, hub.addr).await.err().unwrap().to_string();
    assert!(error.contains("closed by the peer") && error.contains("shows no membership"), "{error}");
    attach(&stranger, None, open.addr).await.unwrap().close().await;

    let robot = Identity::generate("proxy").unwrap();
    let papers = |domain: &Domain, seconds, peers: &[&Signed<PeerCert>]| Credentials {
        membership: domain.admit(robot.name(), "arm", seconds),
        peers: peers.iter().map(|peer| (*peer).clone()).collect(),
    };
    let node = attach(&robot, Some(papers(&home, LONG, &[])), hub.addr).await.unwrap();
    assert_eq!(link_of(&hub_running, robot.name()).await.unwrap()["relationship"], "member");
    node.close().await;
    let error = attach(&robot, Some(papers(&home, -5, &[])), hub.addr).await.err().unwrap().to_string();
    assert!(error.contains("expired 20"), "{error}");

    // A visit to the hub. A robot attaches only to domains that its own domain knows, and only if
    // they know its domain.
    let knows_home = away.peer(&home, "peering", LONG);
    let visitor = papers(&away, LONG, &[&knows_home]);
    let node = attach(&robot, Some(visitor), hub.addr).await.unwrap();
    assert_eq!(link_of(&hub_running, robot.name()).await.unwrap()["relationship"], "visitor");
    node.close().await;
    let error = attach(&robot, Some(papers(&away, LONG, &[])), hub.addr).await.err().unwrap().to_string();
    assert!(error.contains("does not know"), "{error}");
    let knows_away = home.peer(&away, "peering", LONG);
    let error = attach(&robot, Some(papers(&home, LONG, &[&knows_away])), open.addr).await.err().unwrap().to_string();
    assert!(error.contains("closed by the peer") && error.contains("does not know"), "{error}");

    // The link ends with its credentials, and continues with renewed credentials.
    let node = attach(&robot, Some(papers(&home, 6, &[])), hub.addr).await.unwrap();
    let first = link_of(&hub_running, robot.name()).await.unwrap();
    node.renew_credentials(papers(&home, 10, &[])).await.unwrap();
    let renewed = link_of(&hub_running, robot.name()).await.unwrap();
    assert!(first["id"] == renewed["id"] && until(&renewed) > until(&first));
    wait("the end of the link", async || link_of(&hub_running, robot.name()).await.is_none()).await;
    wait("the node to notice", async || node.switch().is_err()).await;
    // Renewal needs no switch: the node presents the new credentials with its next link.
    node.renew_credentials(papers(&home, LONG, &[])).await.unwrap();
    wait("the link again", async || node.switch().is_ok_and(|switch| switch == hub.name)).await;

    // The switch is stolen. Its domain revokes its membership, and nodes that learn of the
    // revocation leave.
    let serial = open.serial();
    let node = attach(&robot, Some(papers(&away, LONG, &[])), open.addr).await.unwrap();
    away.revoke(&open, 1, &[serial]).await;
    wait("the node to leave", async || node.switch().is_err()).await;
    assert!(link_of(&open_running, robot.name()).await.is_none());
}

impl Domain {
    fn invite(&self, role: &str, at: &Place) -> Token {
        let (key, domain, role, serial) =
            (SigningKey::generate().unwrap(), self.identity.name(), role.to_owned(), self.serial());
        let not_after = (now() + LONG) as u64;
        let invite =
            Invite { domain, key: key.verify_key(), role, serial, not_before: 0, not_after, member_until: not_after };
        let signed = issue(self.identity.key(), &invite).unwrap();
        let at_addr = format!("udp://{}", at.addr).parse().unwrap();
        Token::new(self.identity.proof(), signed, key, at_addr, Some(at.name)).unwrap()
    }

    /// Sends a revocation to the daemon at a place.
    async fn revoke(&self, place: &Place, number: u64, serials: &[u64]) {
        self.try_revoke(place, number, serials).unwrap();
    }

    fn try_revoke(&self, place: &Place, number: u64, serials: &[u64]) -> Result<(), String> {
        let mut revoked = serials.to_vec();
        revoked.sort_unstable();
        let claims = Revocation { name: self.identity.name(), number, floor: 0, revoked, signer: None };
        let revocation = issue(self.identity.key(), &claims).unwrap();
        let request = EntityRequest::Revoke { proof: self.identity.proof(), revocation };
        let socket = place.file("switch.sock");
        tokio::task::block_in_place(|| {
            let mut client = Client::connect(&socket).unwrap();
            let asked = client.ask::<Response>(&Request::Entity { entity: None, request: request.into() });
            asked.map(|response| assert!(matches!(response, Response::Done))).map_err(|error| error.to_string())
        })
    }
}

impl Place {
    fn alone(&self) -> Settings {
        self.settings(None)
    }

    fn joined(&self, token: &Token) -> Settings {
        let membership = token.admit(self.name, 0, now() as u64 * 1_000_000_000).unwrap();
        self.put("membership", &membership.to_pem());
        let domain = gdp_core::identity::VerifyKey::from_bytes(&token.domain().owner_key).unwrap();
        let metadata = [("kind".to_owned(), "domain".to_owned())].into();
        self.put("domain.card", &NameCard::new(domain, metadata).unwrap().to_json());
        self.settings_in_domain()
    }

    /// Returns the serial of the membership in the file, or of its invitation.
    fn serial(&self) -> u64 {
        let text = std::fs::read_to_string(self.file("membership")).unwrap();
        Membership::from_pem(&text).unwrap().serial_unverified().unwrap()
    }
}

/// Returns the standing of the peer in a daemon's link list; "none" without a link.
async fn standing(running: &Running, peer: &Place) -> String {
    link_to(running, peer).await.map_or("none".into(), |link| link["relationship"].as_str().unwrap().to_owned())
}

async fn link_to(running: &Running, peer: &Place) -> Option<Value> {
    link_of(running, peer.name).await
}

async fn link_of(running: &Running, peer: Name) -> Option<Value> {
    let status = running.status().await;
    let name = peer.to_string();
    status["links"].as_array().unwrap().iter().find(|link| link["peer"] == name.as_str()).cloned()
}

fn until(link: &Value) -> u64 {
    link["admitted_until"].as_u64().unwrap()
}

async fn attach(identity: &Identity, papers: Option<Credentials>, to: SocketAddr) -> Result<Node, NodeError> {
    let target: LinkTarget = format!("udp://{to}").parse().unwrap();
    let connect_timeout = Duration::from_secs(4);
    Node::connect(NodeConfig { credentials: papers, connect_timeout, ..NodeConfig::new(identity.clone(), target) })
        .await
}

/// Log output of all daemons in this process.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

fn log() -> Log {
    static LOG: OnceLock<Log> = OnceLock::new();
    LOG.get_or_init(|| {
        let log = Log::default();
        let writer = log.clone();
        tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).init();
        log
    })
    .clone()
}

impl Log {
    fn lines(&self) -> Vec<String> {
        let text = String::from_utf8_lossy(&self.0.lock().unwrap()).into_owned();
        text.lines().map(str::to_owned).collect()
    }
}

impl io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
