//! Three replicas of a RIB, each a daemon beside its switch, on three members of etcd. The tests
//! run without root, over UDP on the loopback interface:
//!
//! ```text
//!  writer ── s ───── s ── reader        the third switch leads, until its daemon is killed,
//!              ╲   ╱                    and with it the member of etcd that leads the others
//!                s
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

use gdp::unstable::{Node, NodeConfig, PublishOptions, Publisher, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Advert, AdvertOp, Grantee, Issued, ReadGrant, Reading, RtCert, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_e2e::seal::Encoding;
use gdp_link::link::Link;
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_proto::control::{EntityRequest, RefusalCode, Request, Response};
use gdp_tests::process::terminate;
use gdp_tests::programs::own;
use gdp_wire::Name;
use serde_json::{Value, json};
use tokio::time::{sleep, timeout};

use crate::cluster::Cluster;
use crate::ports::free_addr;

/// Time for a lease to end and for both clusters to elect a new leader, on a loaded machine.
const RECOVERY: Duration = Duration::from_secs(60);

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_lost_when_the_leading_rib_and_a_member_of_etcd_are_killed() {
    let (mut cluster, folder) = (Cluster::start(3), tempfile::tempdir().unwrap());
    let mut switches = Switches::start(folder.path(), &cluster);
    let leader = switches.leader().await;
    let (a, b) = ((leader + 1) % 3, (leader + 2) % 3);
    let (at_a, at_b) = (switches.addrs[a], switches.addrs[b]);

    let owner = Owner::new();
    let (robot, cloud, raw) = (endpoint(), endpoint(), endpoint());
    let (writer, reader) = (connect(&robot, at_a).await, connect(&cloud, at_b).await);
    let topic = owner.name();
    let mut subscription = owner.subscribe(&reader, &topic, &cloud).await;
    let mut publisher = owner.publish(&writer, &topic, &robot).await.expect("a statement");
    let sent = Arc::new(AtomicU64::new(0));
    let stop = Arc::new(AtomicBool::new(false));
    let sending = tokio::spawn({
        let (sent, stop) = (sent.clone(), stop.clone());
        async move {
            while !stop.load(Ordering::Relaxed) {
                let number = sent.fetch_add(1, Ordering::Relaxed);
                publisher.send(Encoding::Bytes, &number.to_be_bytes()).await.expect("sent");
                sleep(Duration::from_millis(5)).await;
            }
            publisher
        }
    });
    let received = Arc::new(AtomicU64::new(0));
    let receiving = tokio::spawn({
        let received = received.clone();
        async move {
            loop {
                let message = subscription.recv().await.expect("the subscription lives");
                let next = received.fetch_add(1, Ordering::Relaxed);
                assert_eq!(message.body[..], next.to_be_bytes(), "a message is missing, or came twice");
            }
        }
    });

    // Publish statements continuously, for one name after the other.
    let stated: Arc<std::sync::Mutex<Vec<(Name, Publisher, Instant)>>> = Arc::default();
    let stating = tokio::spawn({
        let (stated, stop, owner, robot, writer) =
            (stated.clone(), stop.clone(), owner.clone(), robot.clone(), writer.clone());
        async move {
            while !stop.load(Ordering::Relaxed) {
                let card = owner.name();
                match owner.publish(&writer, &card, &robot).await {
                    Ok(publisher) => stated.lock().unwrap().push((card.name(), publisher, Instant::now())),
                    Err(_) => sleep(Duration::from_millis(50)).await,
                }
            }
        }
    });
    let (_port, link) = bare_link(&raw, at_a).await;
    let old = owner.raw_statement(&raw, &switches.names[a], 7);
    attach(&raw, &link, switches.names[a]).await;
    let answer = link.request(&Request::Entity(old.clone())).await.unwrap();
    assert!(matches!(answer, Response::Peers(_)), "{answer:?}");
    wait("statements and messages", async || {
        stated.lock().unwrap().len() >= 30 && received.load(Ordering::Relaxed) >= 100
    })
    .await;
    let names: Vec<Name> = stated.lock().unwrap().iter().map(|(name, ..)| *name).collect();
    let before = serials(&writer, &names).await;

    let killed = Instant::now();
    switches.kill(leader);
    cluster.kill(cluster.leader());
    let survivor = timeout(RECOVERY, switches.leader()).await.expect("another replica leads");
    assert_ne!(survivor, leader);
    let again = async || stated.lock().unwrap().iter().filter(|(.., at)| *at > killed).count() >= 10;
    wait("statements to be taken again", again).await;
    let first = stated.lock().unwrap().iter().map(|(.., at)| *at).find(|at| *at > killed + Duration::from_millis(500));
    println!("statements were taken again after {:?}", first.map(|at| at - killed));

    assert_eq!(serials(&writer, &names).await, before, "what was stated before is there as it was");
    let all: Vec<Name> = stated.lock().unwrap().iter().map(|(name, ..)| *name).collect();
    assert_eq!(serials(&writer, &all).await.len(), all.len(), "all that was said to be done is there");
    let answer = timeout(RECOVERY, link.request(&Request::Entity(old))).await.unwrap().unwrap();
    let replayed = matches!(&answer, Response::Refused(refusal) if refusal.code == RefusalCode::ReplayedSerial);
    assert!(replayed, "{answer:?}");
    let answer = link.request(&Request::Entity(owner.raw_statement(&raw, &switches.names[a], 8))).await.unwrap();
    assert!(matches!(answer, Response::Peers(_)), "{answer:?}");

    stop.store(true, Ordering::Relaxed);
    stating.await.unwrap();
    let publisher = sending.await.unwrap();
    let total = sent.load(Ordering::Relaxed);
    wait("all messages", async || receiving.is_finished() || received.load(Ordering::Relaxed) == total).await;
    assert!(!receiving.is_finished(), "{:?}", receiving.await);
    drop(publisher);

    // The killed replica returns as a follower.
    cluster.restart_all();
    switches.spawn(leader);
    wait("the replica to follow", async || switches.status(leader).is_some_and(|status| status["rib"].is_null())).await;
    assert_eq!(timeout(RECOVERY, switches.leader()).await.expect("a leader"), survivor);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_leader_that_is_told_to_stop_resigns_first() {
    let (cluster, folder) = (Cluster::start(1), tempfile::tempdir().unwrap());
    let mut switches = Switches::start(folder.path(), &cluster);
    let leader = timeout(RECOVERY, switches.leader()).await.expect("a replica leads");
    let of = switches.names[leader].to_string();
    let led_by = || cluster.etcdctl(&[0], &["get", "--print-value-only", "test/rib/leader"]).trim().to_owned();
    assert_eq!(led_by(), of);
    switches.terminate(leader);
    // Without resigning, its lease would last for seconds.
    assert_ne!(led_by(), of, "others may stand");
    let next = timeout(RECOVERY, switches.leader()).await.expect("another replica leads");
    assert!(next != leader && led_by() == switches.names[next].to_string());
    // A follower ends without an election.
    let follower = 3 - leader - next;
    switches.terminate(follower);
    assert_eq!(led_by(), switches.names[next].to_string());
}

async fn wait(what: &str, condition: impl AsyncFn() -> bool) {
    let deadline = Instant::now() + RECOVERY;
    while !condition().await {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        sleep(Duration::from_millis(20)).await;
    }
}

/// Returns the serials of the RIB's statements for these names.
async fn serials(node: &Node, names: &[Name]) -> BTreeMap<Name, u64> {
    let mut serials = BTreeMap::new();
    for name in names {
        let (records, _) = node.query((*name).into(), None).await.expect("the RIB answers");
        serials.extend(records.iter().map(|r| (*name, r.advert.claims_unverified().unwrap().serial)));
    }
    serials
}

/// Three daemons with links between all of them.
struct Switches {
    folder: PathBuf,
    names: Vec<Name>,
    addrs: Vec<SocketAddr>,
    daemons: Vec<Option<Child>>,
}

impl Switches {
    fn start(folder: &Path, cluster: &Cluster) -> Self {
        let names =
            (0..3).map(|i| Identity::load_or_generate(&folder.join(format!("s{i}.pem")), "switch").unwrap().name());
        let names: Vec<Name> = names.collect();
        let addrs = vec![free_addr(), free_addr(), free_addr()];
        let endpoints: Vec<String> = cluster.endpoints().iter().map(ToString::to_string).collect();
        for i in 0..3 {
            let others = (0..3).filter(|j| *j != i);
            let others =
                others.map(|j| json!({"switch": names[j].to_string(), "udp": addrs[j].to_string(), "cost": 1}));
            let config = json!({
                "identity": format!("s{i}.pem"), "socket": format!("s{i}.sock"), "interfaces": [], "udp": addrs[i].to_string(),
                "data_plane": "userspace", "bpffs": null, "rib": true, "neighbours": others.collect::<Vec<_>>(),
                "etcd": {"endpoints": endpoints, "prefix": "test/rib"},
            });
            // JSON is valid YAML.
            fs::write(folder.join(format!("s{i}.yaml")), config.to_string()).unwrap();
        }
        let mut switches = Self { folder: folder.into(), names, addrs, daemons: vec![None, None, None] };
        (0..3).for_each(|i| switches.spawn(i));
        switches
    }

    fn spawn(&mut self, i: usize) {
        let log = fs::File::options().create(true).append(true).open(self.folder.join(format!("s{i}.log"))).unwrap();
        let daemon = own(env!("CARGO_BIN_EXE_gdp-ctl"))
            .args(["serve", "--config"])
            .arg(self.folder.join(format!("s{i}.yaml")))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .unwrap();
        self.daemons[i] = Some(daemon);
    }

    /// Kills a daemon without a clean shutdown.
    fn kill(&mut self, i: usize) {
        if let Some(mut daemon) = self.daemons[i].take() {
            daemon.kill().unwrap();
            daemon.wait().unwrap();
        }
    }

    /// Terminates a daemon and waits until it has ended.
    fn terminate(&mut self, i: usize) {
        if let Some(mut daemon) = self.daemons[i].take() {
            terminate(&daemon).unwrap();
            assert!(daemon.wait().unwrap().success());
        }
    }

    /// Returns the status of a running daemon that answers.
    fn status(&self, i: usize) -> Option<Value> {
        self.daemons[i].as_ref()?;
        let mut command = own(env!("CARGO_BIN_EXE_gdp-ctl"));
        command.arg("--socket").arg(self.folder.join(format!("s{i}.sock"))).args(["status", "-j"]);
        let output = command.output().unwrap();
        output.status.success().then(|| serde_json::from_slice(&output.stdout).unwrap())
    }

    /// Waits until one replica leads and all running daemons can reach it. Returns its index.
    async fn leader(&self) -> usize {
        let mut leader = None;
        let known = async |leader: &mut Option<usize>| {
            let states: Vec<_> = (0..3).filter_map(|i| Some((i, self.status(i)?))).collect();
            let running = self.daemons.iter().flatten().count();
            let leading: Vec<_> = states.iter().filter(|(_, status)| !status["rib"].is_null()).collect();
            *leader = leading.first().map(|(i, _)| *i);
            // A killed daemon is still counted for a while.
            let known = leading.first().and_then(|(_, status)| status["rib"]["switches"].as_u64());
            let all_known = known.is_some_and(|known| known >= running as u64);
            states.len() == running && leading.len() == 1 && all_known
        };
        while !known(&mut leader).await {
            sleep(Duration::from_millis(50)).await;
        }
        leader.expect("one leads")
    }
}

impl Drop for Switches {
    fn drop(&mut self) {
        (0..3).for_each(|i| self.kill(i));
        if std::thread::panicking() {
            for i in 0..3 {
                let log = fs::read_to_string(self.folder.join(format!("s{i}.log"))).unwrap_or_default();
                eprintln!("--- s{i}\n{log}");
            }
        }
    }
}

/// The owner of all names.
#[derive(Clone)]
struct Owner(SigningKey);

impl Owner {
    fn new() -> Self {
        Self(SigningKey::generate().unwrap())
    }

    /// Creates a new name.
    fn name(&self) -> NameCard {
        NameCard::create(self.0.verify_key(), "topic", "/chatter", "T", None).unwrap()
    }

    fn ad_cert(&self, card: &NameCard, entity: &Identity) -> Issued<AdCert> {
        let cert = AdCert {
            name: card.name(),
            entity: entity.name(),
            scope: vec![],
            serial: 1,
            not_before: 0,
            not_after: unix_seconds() + 3600,
        };
        issue(&self.0, &cert).unwrap().into()
    }

    async fn publish(
        &self,
        node: &Node,
        card: &NameCard,
        entity: &Identity,
    ) -> Result<Publisher, gdp::unstable::NodeError> {
        node.publish(card.proof(), self.ad_cert(card, entity), PublishOptions::reliable()).await
    }

    async fn subscribe(&self, node: &Node, card: &NameCard, entity: &Identity) -> Subscription {
        let grant = ReadGrant {
            name: card.name(),
            to: Grantee::Entity(entity.name()),
            serial: 1,
            not_before: 0,
            not_after: unix_seconds() + 3600,
        };
        let grant: Reading = issue(&self.0, &grant).unwrap().into();
        node.subscribe(card.proof(), grant, SubscribeOptions::reliable()).await.unwrap()
    }

    fn raw_statement(&self, entity: &Identity, switch: &Name, serial: u64) -> EntityRequest {
        let card = self.name();
        let says = Advert {
            op: AdvertOp::Publish,
            name: card.name(),
            entity: entity.name(),
            switch: *switch,
            serial,
            lifetime: 3600,
            box_key: entity.box_public(),
        };
        let advert = issue(entity.key(), &says).unwrap();
        EntityRequest::Advertise {
            proof: card.proof(),
            ad_cert: self.ad_cert(&card, entity),
            advert,
            everywhere: false,
        }
    }
}

fn endpoint() -> Identity {
    Identity::generate("proxy").unwrap()
}

async fn connect(identity: &Identity, at: SocketAddr) -> Node {
    let target = format!("udp://{at}").parse().unwrap();
    Node::connect(NodeConfig::new(identity.clone(), target)).await.unwrap()
}

/// Returns a link with its port. Dropping the port closes the link.
async fn bare_link(identity: &Identity, at: SocketAddr) -> (Port, Link) {
    let port = Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::endpoint(identity.clone())).unwrap();
    let link = port.dial(LinkAddr::udp(at), None).await.unwrap();
    (port, link)
}

async fn attach(identity: &Identity, link: &Link, switch: Name) {
    let claims = RtCert { entity: identity.name(), switch, not_after: unix_seconds() + 3600 };
    let rt_cert = issue(identity.key(), &claims).unwrap();
    let request = EntityRequest::Attach { rt_cert, resumes: true, lane: 0 };
    let attached = link.request(&Request::Entity(request)).await.unwrap();
    assert!(matches!(attached, Response::Attached { .. }), "{attached:?}");
}

fn unix_seconds() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs()
}
