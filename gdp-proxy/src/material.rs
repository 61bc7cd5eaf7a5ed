//! The files that a configuration names: identity, name cards, certificates. Read at start (certificates also when they change: `cert_file`), and checked
//! against each other here, so that a mistake is said with the key of the configuration it is under, and not as a refusal from a RIB
//! three hops away. The RIB verifies everything again.

use std::fmt::Display;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use gdp::cert::{AdCert, CertError, Issued, MAX_CERT_FILE, Reading};
use gdp::domain::{PaperFiles, Papers, Stamps, Trust};
use gdp::{Identity, Name, NameCard, SigningKey};

use crate::cert_file::CertFile;
use crate::config::{Config, Direction, TopicConfig};
use crate::relay::Relay;
use crate::ros2::TypeName;

/// Everything secret or signed that a proxy works with.
pub struct Material {
    pub identity: Identity,
    /// With what their files were like.
    pub papers: Option<(Papers, Stamps)>,
    pub relay: Option<Relay>,
    /// In the order of the configuration's topics.
    pub topics: Vec<TopicMaterial>,
}

pub struct TopicMaterial {
    pub card: NameCard,
    /// From the configuration or the card; always there for [`Direction::In`].
    pub kind: Option<TypeName>,
    pub permission: Permission,
    /// Where that came from.
    pub(crate) file: CertFile,
}

/// What the owner of the name allows this proxy.
pub enum Permission {
    Publish(Issued<AdCert>),
    Read(Reading),
}

impl Permission {
    /// Of a topic that goes out.
    pub fn publish(self) -> Option<Issued<AdCert>> {
        match self {
            Self::Publish(cert) => Some(cert),
            Self::Read(_) => None,
        }
    }

    /// Of a topic that comes in.
    pub fn read(self) -> Option<Reading> {
        match self {
            Self::Publish(_) => None,
            Self::Read(grant) => Some(grant),
        }
    }
}

/// A file does not do for what the configuration wants of it.
#[derive(Debug, thiserror::Error)]
#[error("{key}: {reason}")]
pub struct MaterialError {
    /// `topics[0].cert`
    pub(crate) key: String,
    pub(crate) reason: String,
}

impl Material {
    pub fn load(config: &Config) -> Result<Self, MaterialError> {
        let identity = load_identity(&config.identity, "proxy")
            .map_err(|reason| MaterialError { key: "identity".into(), reason: with_path(reason, &config.identity) })?;
        let load = |(i, topic)| {
            load_topic(topic, identity.name())
                .map_err(|(key, reason)| MaterialError { key: format!("topics[{i}].{key}"), reason })
        };
        let topics = config.topics.iter().enumerate().map(load).collect::<Result<Vec<_>, _>>()?;
        let papers = config.domain.as_ref().map(|domain| load_papers(&domain.into(), identity.name())).transpose()?;
        let relay = Relay::load(config)?;
        let material = Self { identity, papers, relay, topics };
        material.check_names(config)?;
        Ok(material)
    }

    /// A name has one publisher and one subscription per proxy: two topics in it would be indistinguishable at its readers.
    fn check_names(&self, config: &Config) -> Result<(), MaterialError> {
        let what = |i: usize| (self.topics[i].card.name(), config.topics[i].direction);
        for i in 0..self.topics.len() {
            if let Some(first) = (0..i).find(|first| what(*first) == what(i)) {
                let reason = format!(
                    "the name {:#} is already that of topics[{first}], in the same direction; make a card of its own for {}",
                    self.topics[i].card.name(),
                    config.topics[i].topic
                );
                return Err(MaterialError { key: format!("topics[{i}].card"), reason });
            }
        }
        Ok(())
    }
}

/// Of an entity of this kind.
pub(crate) fn load_identity(path: &Path, kind: &str) -> Result<Identity, String> {
    match SigningKey::load(path) {
        Ok(key) => Ok(Identity::new(key, kind)),
        Err(error) if error.is_not_found() => {
            Err(format!("{error}; make one with `gdp-ctl key generate {} --kind {kind}`", path.display()))
        }
        Err(error) => Err(error.to_string()),
    }
}

fn load_papers(files: &PaperFiles, entity: Name) -> Result<(Papers, Stamps), MaterialError> {
    let wrong = |reason: String| MaterialError { key: "domain".into(), reason };
    let stamps = files.stamps();
    let papers = files.load().map_err(|error| wrong(error.to_string()))?;
    Trust::new(entity, papers.clone().into(), true).map_err(|error| wrong(error.to_string()))?;
    Ok((papers, stamps))
}

/// Errors with the key inside the topic.
fn load_topic(topic: &TopicConfig, entity: Name) -> Result<TopicMaterial, (&'static str, String)> {
    let card = NameCard::load(&topic.card).map_err(|error| ("card", with_path(error, &topic.card)))?;
    let kind = agree_on_type(topic, &card).map_err(|reason| ("type", reason))?;
    let opened = CertFile::open(topic, &card, entity);
    let (file, permission) = opened.map_err(|error| ("cert", with_path(error, &topic.cert)))?;
    Ok(TopicMaterial { card, kind, permission, file })
}

fn agree_on_type(topic: &TopicConfig, card: &NameCard) -> Result<Option<TypeName>, String> {
    let carded = card.get("type").filter(|text| !text.is_empty()).map(TypeName::parse).transpose();
    let carded = carded.map_err(|error| format!("{}: {error}", topic.card.display()))?;
    match (&topic.kind, carded) {
        (Some(configured), Some(carded)) if *configured != carded => Err(format!(
            "{configured}, but the name is of a topic of {carded} ({}): correct one of them, bytes are not converted",
            topic.card.display()
        )),
        (None, None) if topic.direction == Direction::In => Err(
            "missing, and the name card does not say it either; write the message type, such as std_msgs/msg/String"
                .into(),
        ),
        (configured, carded) => Ok(configured.clone().or(carded)),
    }
}

/// What the topic's certificate file holds now.
pub(crate) fn load_permission(topic: &TopicConfig, card: &NameCard, entity: Name) -> Result<Permission, String> {
    let mut text = String::new();
    let file = File::open(&topic.cert).map_err(|error| error.to_string())?;
    file.take(MAX_CERT_FILE as u64 + 1).read_to_string(&mut text).map_err(|error| error.to_string())?;
    check_permission(topic.direction, &text, card, entity, unix_now()).map_err(|error| error.to_string())
}

/// Seconds since 1970; 0 of a clock that is before that.
pub(crate) fn unix_now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs())
}

fn check_permission(
    direction: Direction,
    text: &str,
    card: &NameCard,
    entity: Name,
    now: u64,
) -> Result<Permission, CertError> {
    match direction {
        Direction::Out => {
            let cert = Issued::<AdCert>::from_pem(text)?;
            let certified = cert.verify(&card.proof(), None, now)?.entity;
            if certified != entity {
                return Err(CertError::WrongEntity { expected: entity, got: certified });
            }
            Ok(Permission::Publish(cert))
        }
        Direction::In => {
            let grant = Reading::from_pem(text)?;
            grant.verify(&card.proof(), entity, None, now)?;
            Ok(Permission::Read(grant))
        }
    }
}

/// The reason with the file in front, unless it names the file already.
pub(crate) fn with_path(reason: impl Display, path: &Path) -> String {
    let (reason, path) = (reason.to_string(), path.display().to_string());
    if reason.contains(&path) { reason } else { format!("{path}: {reason}") }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use gdp::cert::{Delegation, Grantee, MemberCert, Membership, Mode, ReadGrant, issue};
    use std::fs;
    use std::path::PathBuf;

    #[test]
    fn files_that_belong_together_are_taken() {
        let files = Files::new();
        let material = files.load("").unwrap();
        assert_eq!(material.identity.name(), files.entity);
        let [out, inward] = &material.topics[..] else { panic!("two topics") };
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

    /// As one without a battery-backed clock is, until somebody tells it the time.
    #[test]
    fn a_machine_in_1970_is_told_to_look_at_its_clock() {
        let files = Files::new();
        let ad = issue(&files.owner, &AdCert { not_before: unix_now(), ..files.claims() }).unwrap().to_pem();
        let refusal = |now| check_permission(Direction::Out, &ad, &files.card, files.entity, now).err();
        assert!(refusal(unix_now()).is_none());
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
        let delegation =
            Delegation { name, delegate: delegate.verify_key(), publish, read, serial, not_before, not_after };
        let delegation = Some(issue(&files.owner, &delegation).unwrap());
        let cert = issue(&delegate, &files.claims()).unwrap();
        let issued = Issued { cert, delegation: delegation.clone() };
        fs::write(files.path("t.ad"), issued.to_pem()).unwrap();

        let role = String::from("operator");
        let to = Grantee::Role { domain: domain.name(), role: role.clone() };
        let grant = issue(&delegate, &ReadGrant { name, to, serial, not_before, not_after }).unwrap();
        let member = MemberCert { domain: domain.name(), entity: files.entity, role, serial, not_before, not_after };
        let member = Some(Membership::issue(&domain, &member).unwrap());
        let mut reading = Reading { grant: Issued { cert: grant, delegation }, member };
        fs::write(files.path("t.grant"), reading.to_pem()).unwrap();
        files.load("").unwrap();

        reading.member = None;
        fs::write(files.path("t.grant"), reading.to_pem()).unwrap();
        let refusal = files.refusal("");
        assert!(refusal.starts_with("topics[1].cert") && refusal.contains("operator"), "{refusal}");
    }

    #[test]
    fn the_type_of_the_name_is_not_another_one() {
        let refusal = Files::new().refusal("type: std_msgs/msg/Int32, ");
        assert!(refusal.contains("std_msgs/msg/Int32, but") && refusal.contains("std_msgs/msg/String"), "{refusal}");
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
            AdCert { name, entity, mode: Mode::Unicast, scope: vec![], serial: 1, not_before: 0, not_after: u64::MAX }
        }

        /// One topic out and one in; `extra` is said of the one that goes out.
        fn load(&self, extra: &str) -> Result<Material, MaterialError> {
            Material::load(&self.config(extra))
        }

        pub fn config(&self, extra: &str) -> Config {
            let text = format!(
                "{{identity: id.pem, links: [{{to: 'eth://r0'}}], topics: [\
                 {{topic: /chatter, {extra}direction: out, card: t.card, cert: t.ad}}, \
                 {{topic: /other, direction: in, card: t.card, cert: t.grant}}]}}"
            );
            Config::parse(&text, &self.path("robot.yaml")).unwrap()
        }

        fn refusal(&self, extra: &str) -> String {
            self.load(extra).err().expect("a refusal").to_string()
        }
    }
}
