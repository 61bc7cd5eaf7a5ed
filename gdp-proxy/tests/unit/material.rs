//! Unit tests of `material`.

use super::*;
use crate::ros2::TopicName;
use gdp_core::cert::{AdCert, Delegation, Grantee, Issued, MemberCert, Membership, ReadGrant, issue};
use gdp_util::unix_time::unix_seconds;
use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;
use tokio::runtime::Runtime;

#[test]
fn files_that_belong_together_are_taken() {
    let files = Files::new();
    let material = files.load("").unwrap();
    assert_eq!(material.identity.name(), files.entity);
    let [(0, out), (1, inward)] = &material.routes[..] else { panic!("two topics") };
    assert_eq!(out.kind.as_ref().unwrap().as_str(), "std_msgs/msg/String");
    assert!(matches!(out.permission, Permission::Publish(_)) && matches!(inward.permission, Permission::Read(_)));
}

#[test]
fn what_is_missing_or_open_to_others_is_named() {
    for (file, key) in [("id.pem", "identity"), ("t.card", "topics[0].card"), ("t.ad", "topics[0].cert")] {
        let files = Files::new();
        fs::remove_file(files.path(file)).unwrap();
        let refusal = files.refusal("");
        assert!(refusal.starts_with(key) && refusal.contains(file), "{refusal}");
    }
    let files = Files::new();
    fs::set_permissions(files.path("id.pem"), std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
    let refusal = files.refusal("");
    assert!(refusal.starts_with("identity") && refusal.contains("chmod 600"), "{refusal}");
}

#[test]
fn a_certificate_of_the_other_kind_of_another_owner_entity_or_time_is_refused() {
    let files = Files::new();
    fs::copy(files.path("t.grant"), files.path("t.ad")).unwrap();
    assert!(files.refusal("").contains("AD CERT"), "{}", files.refusal(""));

    let other = SigningKey::generate().unwrap();
    let cases: [(&str, &SigningKey, AdCert); 3] = [
        ("wrong key", &other, files.claims()),
        ("wrong entity", &files.owner, AdCert { entity: Name::from_bytes([1; 32]), ..files.claims() }),
        ("expired", &files.owner, AdCert { not_after: 1, ..files.claims() }),
    ];
    for (expected, signer, claims) in cases {
        fs::write(files.path("t.ad"), issue(signer, &claims).unwrap().to_pem()).unwrap();
        let refusal = files.refusal("");
        assert!(refusal.starts_with("topics[0].cert") && refusal.contains(expected), "{refusal}");
    }
}

/// In a proxy that is built with relays, `tests/relay.rs` runs one.
#[cfg(not(feature = "relay"))]
#[test]
fn a_relay_is_refused_by_a_proxy_that_is_built_without() {
    let files = Files::new();
    let mut config = files.config("");
    config.relay = Some(crate::config::RelayConfig::default());
    let refusal = Material::load(&config, &watcher()).err().expect("a refusal").to_string();
    assert!(refusal.starts_with("relay: ") && refusal.contains("--features relay"), "{refusal}");
}

/// As one without a battery-backed clock is, until somebody tells it the time.
#[test]
fn a_machine_in_1970_is_told_to_look_at_its_clock() {
    let files = Files::new();
    let ad = issue(&files.owner, &AdCert { not_before: unix_seconds(), ..files.claims() }).unwrap().to_pem();
    let refusal = |now| check_permission(Side::Out, &ad, &files.card, files.entity, now).err();
    assert!(refusal(unix_seconds()).is_none());
    let said = refusal(0).unwrap().to_string();
    assert!(said.contains("not yet valid") && said.contains("check the clock"), "{said}");
}

/// From a delegate, and for a role: the file holds what the certificate rests on.
#[test]
fn a_certificate_comes_with_all_that_it_rests_on() {
    let files = Files::new();
    let (delegate, domain) = (SigningKey::generate().unwrap(), Identity::generate("domain").unwrap());
    let (name, not_before, not_after) = (files.card.name(), 0, u64::MAX);
    let (publish, read, serial) = (true, true, 1);
    let delegation = Delegation { name, delegate: delegate.verify_key(), publish, read, serial, not_before, not_after };
    let delegation = Some(issue(&files.owner, &delegation).unwrap());
    let cert = issue(&delegate, &files.claims()).unwrap();
    let issued = Issued { cert, delegation: delegation.clone() };
    fs::write(files.path("t.ad"), issued.to_pem()).unwrap();

    let role = String::from("operator");
    let to = Grantee::Role { domain: domain.name(), role: role.clone() };
    let grant = issue(&delegate, &ReadGrant { name, to, serial, not_before, not_after }).unwrap();
    let member = MemberCert { domain: domain.name(), entity: files.entity, role, serial, not_before, not_after };
    let member = Some(Membership::issue(&domain, &member).unwrap());
    let mut reading = Reading { grant: Issued { cert: grant, delegation }, member: member.map(Box::new) };
    fs::write(files.path("t.grant"), reading.to_pem()).unwrap();
    files.load("").unwrap();

    reading.member = None;
    fs::write(files.path("t.grant"), reading.to_pem()).unwrap();
    let refusal = files.refusal("");
    assert!(refusal.starts_with("topics[1].grant") && refusal.contains("operator"), "{refusal}");
}

#[test]
fn a_name_is_of_one_topic_in_each_direction() {
    let files = Files::new();
    let mut config = files.config("");
    config.topics.push(config.topics[1].clone());
    config.topics[2].topic = TopicName::parse("/third").unwrap();
    let refusal = Material::load(&config, &watcher()).err().expect("a refusal").to_string();
    assert!(refusal.starts_with("topics[2].card: ") && refusal.contains("already that of topics[1].card"), "{refusal}");

    let mut config = files.config("");
    let import = "{catalog: t.card, grant: t.grant, topics: []}";
    let mut import: ImportConfig = serde_saphyr::from_str(import).unwrap();
    (import.catalog, import.grant) = (files.path("t.card"), files.path("t.grant"));
    config.import.push(import);
    let refusal = Material::load(&config, &watcher()).err().expect("a refusal").to_string();
    assert!(refusal.starts_with("import[0].catalog: ") && refusal.contains("topics[1].card"), "{refusal}");
}

#[test]
fn the_type_of_the_name_is_not_another_one() {
    let refusal = Files::new().refusal("type: std_msgs/msg/Int32, ");
    assert!(refusal.contains("std_msgs/msg/Int32, but") && refusal.contains("std_msgs/msg/String"), "{refusal}");
}

/// Watches files in a runtime of its own, for tests that have none.
pub fn watcher() -> FileWatcher {
    static WATCHER: LazyLock<(Runtime, FileWatcher)> = LazyLock::new(|| {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let watcher = {
            let _entered = runtime.enter();
            FileWatcher::start()
        };
        (runtime, watcher)
    });
    WATCHER.1.clone()
}

pub struct Files {
    folder: tempfile::TempDir,
    pub owner: SigningKey,
    pub entity: Name,
    pub card: NameCard,
}

impl Files {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let owner = SigningKey::generate().unwrap();
        let key = SigningKey::generate().unwrap();
        let entity = Identity::new(key.clone(), "proxy").name();
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "std_msgs/msg/String", None).unwrap();
        let files = Self { folder, owner, entity, card };
        key.save_new(&files.path("id.pem")).unwrap();
        files.card.save_new(&files.path("t.card")).unwrap();
        fs::write(files.path("t.ad"), issue(&files.owner, &files.claims()).unwrap().to_pem()).unwrap();
        let (name, to) = (files.card.name(), Grantee::Entity(entity));
        let grant = ReadGrant { name, to, serial: 1, not_before: 0, not_after: u64::MAX };
        fs::write(files.path("t.grant"), issue(&files.owner, &grant).unwrap().to_pem()).unwrap();
        files
    }

    pub fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    pub fn claims(&self) -> AdCert {
        let (name, entity) = (self.card.name(), self.entity);
        AdCert { name, entity, scope: vec![], serial: 1, not_before: 0, not_after: u64::MAX }
    }

    /// One topic out and one in; `extra` is said of the one that goes out.
    fn load(&self, extra: &str) -> Result<Material, MaterialError> {
        Material::load(&self.config(extra), &watcher())
    }

    pub fn config(&self, extra: &str) -> Config {
        let text = format!(
            "{{version: 1, identity: id.pem, links: [{{to: 'eth://r0'}}], topics: [\
             {{topic: /chatter, {extra}direction: out, card: t.card, cert: t.ad}}, \
             {{topic: /other, direction: in, card: t.card, grant: t.grant}}]}}"
        );
        Config::parse(&text, &self.path("robot.yaml")).unwrap()
    }

    fn refusal(&self, extra: &str) -> String {
        self.load(extra).err().expect("a refusal").to_string()
    }
}
