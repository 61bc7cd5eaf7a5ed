//! A switch with its RIB, owners of topics, and proxies as programs.

use std::fs;
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{SystemTime, UNIX_EPOCH};

use gdp::unstable::{Node, NodeConfig, PublishOptions, Publisher, Server, SubscribeOptions, Subscription};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_daemon::serve::{Running, start};
use gdp_tests::programs::own;
use gdp_wire::Name;
use serde_json::Value;

use crate::hub;

pub struct Site {
    folder: tempfile::TempDir,
    hub: Running,
}

/// A topic, a service or an action, and its owner.
pub struct Topic {
    /// `topic`, `service` or `action`.
    what: &'static str,
    topic: String,
    owner: SigningKey,
    card: NameCard,
}

/// A proxy as a program, that ends with the test.
pub struct Proxy {
    child: Child,
    stats: PathBuf,
}

impl Drop for Proxy {
    fn drop(&mut self) {
        // It may have ended by itself.
        _ = self.child.kill();
        _ = self.child.wait();
    }
}

impl Proxy {
    /// Of its routes, as the statistics say them; none before there are some.
    pub fn statuses(&self) -> Vec<String> {
        let routes = self.shown("topics");
        routes.iter().map(|route| route["status"].as_str().unwrap().to_owned()).collect()
    }

    /// Of its topics, all that the statistics say.
    pub fn topics(&self) -> Vec<Value> {
        self.shown("topics")
    }

    /// Of its services and actions, all that the statistics say.
    pub fn calls(&self) -> Vec<Value> {
        self.shown("calls")
    }

    fn shown(&self, key: &str) -> Vec<Value> {
        let stats: Value =
            fs::read(&self.stats).ok().and_then(|read| serde_json::from_slice(&read).ok()).unwrap_or_default();
        stats[key].as_array().cloned().unwrap_or_default()
    }

    /// How many files it has open.
    pub fn descriptors(&self) -> usize {
        fs::read_dir(format!("/proc/{}/fd", self.child.id())).unwrap().count()
    }

    pub fn signal(&self, signal: i32) {
        // SAFETY: no memory is involved; the child is not reaped yet, so this is its number.
        assert_eq!(unsafe { libc::kill(self.child.id() as i32, signal) }, 0);
    }

    /// Ends it as whoever runs it does.
    pub fn stop(mut self) {
        self.signal(libc::SIGTERM);
        self.child.wait().unwrap();
    }
}

impl Site {
    pub async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let hub = start(hub::config(folder.path(), None)).await.unwrap();
        Self { folder, hub }
    }

    pub fn topic(&self, topic: &str, kind: &str) -> Topic {
        self.name("topic", topic, kind)
    }

    /// Of a `topic`, a `service` or an `action`.
    pub fn name(&self, what: &'static str, topic: &str, kind: &str) -> Topic {
        let owner = SigningKey::generate().unwrap();
        let card = NameCard::create(owner.verify_key(), what, topic, kind, None).unwrap();
        Topic { what, topic: topic.into(), owner, card }
    }

    /// Of a service that its owner has marked as idempotent.
    pub fn idempotent(&self, service: &str, kind: &str) -> Topic {
        let Topic { what, topic, owner, card } = self.name("service", service, kind);
        let mut metadata = card.metadata().clone();
        metadata.insert("idempotent".into(), "true".into());
        let card = NameCard::new(owner.verify_key(), metadata).unwrap();
        Topic { what, topic, owner, card }
    }

    /// In this graph, with these, those of a kind together, of each of which `says` is said.
    pub fn proxy(&self, label: &str, graph: &str, topics: &[Topic], says: &str) -> Proxy {
        self.proxy_of(label, graph, topics, says, "")
    }

    /// The same, with `more` in its configuration.
    pub fn proxy_of(&self, label: &str, graph: &str, topics: &[Topic], says: &str, more: &str) -> Proxy {
        let mut config = format!("{more}\n");
        for (i, topic) in topics.iter().enumerate() {
            if i == 0 || topics[i - 1].what != topic.what {
                config += &format!("{}s:\n", topic.what);
            }
            config += &self.give(label, i, topic, says);
        }
        self.begin(label, graph, &config)
    }

    /// Gives a proxy what it needs for a topic, its `i`th; returns the line of the configuration.
    pub fn give(&self, label: &str, i: usize, topic: &Topic, says: &str) -> String {
        let (folder, name) = (self.folder(label), self.identity(label).name());
        let mut rights = String::new();
        if !says.contains("direction: in") {
            fs::write(folder.join(format!("{i}.ad")), topic.ad_cert(name)).unwrap();
            rights += &format!("cert: {i}.ad, ");
        }
        if !says.contains("direction: out") {
            fs::write(folder.join(format!("{i}.grant")), topic.grant(name).to_pem()).unwrap();
            rights += &format!("grant: {i}.grant, ");
        }
        fs::write(folder.join(format!("{i}.card")), topic.card.to_json()).unwrap();
        format!("  - {{{}: {}, card: {i}.card, {rights}{says}}}\n", topic.what, topic.topic)
    }

    /// Lets one proxy read all that another exposes: what their configurations say, with these
    /// patterns.
    pub fn by_pattern(&self, from: &str, to: &str, expose: &str, import: &str) -> (String, String) {
        let (owner, reader) = (SigningKey::generate().unwrap(), self.identity(to).name());
        owner.save_new(&self.folder(from).join("owner.pem")).unwrap();
        let catalog = NameCard::create(owner.verify_key(), "catalog", from, "", None).unwrap();
        let (name, grantee) = (catalog.name(), Grantee::Entity(reader));
        let grant = ReadGrant { name, to: grantee, serial: 1, not_before: 0, not_after: u64::MAX };
        fs::write(self.folder(to).join(format!("{from}.grant")), issue(&owner, &grant).unwrap().to_pem()).unwrap();
        for label in [from, to] {
            catalog.save_new(&self.folder(label).join(format!("{from}.card"))).unwrap();
        }
        (
            format!("expose: {{owner: owner.pem, catalog: {from}.card, readers: [{reader}], {expose}}}\n"),
            format!("import: [{{catalog: {from}.card, grant: {from}.grant, {import}}}]\n"),
        )
    }

    /// Where the files of a proxy are.
    pub fn folder(&self, label: &str) -> PathBuf {
        let folder = self.folder.path().join(label);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    pub fn identity(&self, label: &str) -> Identity {
        Identity::load_or_generate(&self.folder(label).join("key.pem"), "proxy").unwrap()
    }

    /// Writes the configuration of a proxy in this graph, which says this besides.
    pub fn configure(&self, label: &str, graph: &str, says: &str) {
        let to = self.hub.udp_addr().unwrap();
        let config =
            format!("version: 1\nidentity: key.pem\nlinks: [{{to: 'udp://{to}'}}]\ngraphs: {{a: {graph}}}\n{says}");
        self.identity(label);
        fs::write(self.folder(label).join("new.yaml"), config).unwrap();
        fs::rename(self.folder(label).join("new.yaml"), self.folder(label).join("proxy.yaml")).unwrap();
    }

    /// Begins it as well. What it logs is in `log`, what it counts in `stats`.
    pub fn begin(&self, label: &str, graph: &str, says: &str) -> Proxy {
        self.configure(label, graph, says);
        let folder = self.folder(label);
        let log = fs::File::create(folder.join("log")).unwrap();
        let mut command = own(env!("CARGO_BIN_EXE_gdp-proxy"));
        let stats = folder.join("stats.json");
        command.arg("--config").arg(folder.join("proxy.yaml")).arg("--stats").arg(&stats);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(log);
        Proxy { child: command.spawn().unwrap(), stats }
    }

    async fn node(&self) -> (Identity, Node) {
        let identity = Identity::generate("proxy").unwrap();
        let target = format!("udp://{}", self.hub.udp_addr().unwrap()).parse().unwrap();
        let node = Node::connect(NodeConfig::new(identity.clone(), target)).await.unwrap();
        (identity, node)
    }

    /// Publishes a topic's name without a proxy.
    pub async fn publish(&self, topic: &Topic) -> Publisher {
        let (identity, node) = self.node().await;
        let cert = topic.signed_ad_cert(identity.name());
        node.publish(topic.card.proof(), cert.into(), PublishOptions::reliable()).await.unwrap()
    }

    /// The topics that a proxy shows in its statistics as carried.
    pub fn carried(&self, label: &str) -> Vec<String> {
        let stats = fs::read(self.folder(label).join("stats.json")).unwrap_or_default();
        let stats: serde_json::Value = serde_json::from_slice(&stats).unwrap_or_default();
        let topics = stats["topics"].as_array().cloned().unwrap_or_default();
        let up = topics.iter().filter(|topic| topic["status"] == "up");
        up.map(|topic| topic["topic"].as_str().unwrap().to_owned()).collect()
    }

    /// Serves a service's name without a proxy.
    pub async fn serve(&self, service: &Topic) -> Server {
        let (identity, node) = self.node().await;
        node.serve(service.card.proof(), service.signed_ad_cert(identity.name()).into()).await.unwrap()
    }

    /// What a proxy has logged.
    pub fn log(&self, label: &str) -> String {
        fs::read_to_string(self.folder(label).join("log")).unwrap()
    }

    /// Reads a topic's name without a proxy.
    pub async fn subscribe(&self, topic: &Topic) -> Subscription {
        let (identity, node) = self.node().await;
        let (proof, grant) = (topic.card.proof(), topic.grant(identity.name()));
        node.subscribe(proof, grant.into(), SubscribeOptions::as_offered()).await.unwrap()
    }
}

impl Topic {
    fn ad_cert(&self, entity: Name) -> String {
        self.signed_ad_cert(entity).to_pem()
    }

    fn signed_ad_cert(&self, entity: Name) -> gdp_core::cert::Signed<AdCert> {
        let (name, scope, serial) = (self.card.name(), vec![], now());
        let cert = AdCert { name, entity, scope, serial, not_before: 0, not_after: u64::MAX };
        issue(&self.owner, &cert).unwrap()
    }

    fn grant(&self, entity: Name) -> gdp_core::cert::Signed<ReadGrant> {
        let (name, to, serial) = (self.card.name(), Grantee::Entity(entity), now());
        issue(&self.owner, &ReadGrant { name, to, serial, not_before: 0, not_after: u64::MAX }).unwrap()
    }
}

fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64
}
