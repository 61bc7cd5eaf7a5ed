//! Domains and member daemons on loopback UDP, for tests that run daemons in their own process.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Mutex;
use std::time::{SystemTime, UNIX_EPOCH};

use gdp_core::card::NameCard;
use gdp_core::cert::{MemberCert, Membership, PeerCert, Signed, issue};
use gdp_core::domain::CredentialFiles;
use gdp_core::identity::Identity;
use gdp_daemon::config::{Config, DomainConfig, Inside, Neighbour, NeighbourAddress as At, Via};
use gdp_daemon::serve::{Running, start};
use gdp_wire::Name;

use crate::ports::free_addr;
use crate::switch::config;

/// Validity in seconds of certificates that must last for a whole test.
pub const LONG: i64 = 3600;

/// A domain's key, and its serials.
pub struct Domain {
    pub identity: Identity,
    pub serials: Mutex<u64>,
}

impl Domain {
    /// Creates a domain. Domains with different numbers have different serials, so that logs
    /// identify the domain.
    pub fn new(number: u64) -> Self {
        let serial = now() as u64 * 1_000_000_000 - number * 1_000_000;
        Self { identity: Identity::generate("domain").unwrap(), serials: serial.into() }
    }

    pub fn serial(&self) -> u64 {
        let mut serials = self.serials.lock().unwrap();
        *serials += 1;
        *serials
    }

    pub fn admit(&self, entity: Name, role: &str, seconds: i64) -> Membership {
        let (domain, serial, role) = (self.identity.name(), self.serial(), role.to_owned());
        let (not_before, not_after) = (0, (now() + seconds) as u64);
        Membership::issue(&self.identity, &MemberCert { domain, entity, role, serial, not_before, not_after }).unwrap()
    }

    pub fn peer(&self, peer: &Domain, rights: &str, seconds: i64) -> Signed<PeerCert> {
        let (domain, peer, rights) = (self.identity.name(), peer.identity.name(), rights.parse().unwrap());
        let (serial, not_before, not_after) = (self.serial(), 0, (now() + seconds) as u64);
        issue(self.identity.key(), &PeerCert { domain, peer, rights, serial, not_before, not_after }).unwrap()
    }
}

/// The address and the files of a daemon.
pub struct Place {
    pub folder: tempfile::TempDir,
    pub name: Name,
    pub addr: SocketAddr,
}

/// Configuration of a daemon.
pub struct Settings(pub Config);

impl Place {
    pub fn new(label: &str) -> Self {
        let folder = tempfile::Builder::new().prefix(label).tempdir().unwrap();
        let name = Identity::load_or_generate(&folder.path().join("switch.pem"), "switch").unwrap().name();
        Self { folder, name, addr: free_addr() }
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn member(&self, domain: &Domain, role: &str, seconds: i64) -> Settings {
        self.renew(domain, role, seconds);
        self.settings(Some(domain))
    }

    /// Replaces the membership file.
    pub fn renew(&self, domain: &Domain, role: &str, seconds: i64) {
        self.put("membership", &domain.admit(self.name, role, seconds).to_pem());
    }

    pub fn put(&self, file: &str, text: &str) {
        let fresh = self.file("fresh");
        std::fs::write(&fresh, text).unwrap();
        std::fs::rename(fresh, self.file(file)).unwrap();
    }

    /// Returns settings that match the files.
    pub fn settings(&self, domain: Option<&Domain>) -> Settings {
        let Some(domain) = domain else {
            return Settings(Config { udp: Some(self.addr), rib: false, ..config(self.folder.path(), "switch") });
        };
        let identity = &domain.identity;
        let card = NameCard::new(identity.key().verify_key(), identity.metadata().clone()).unwrap();
        self.put("domain.card", &card.to_json());
        self.settings_in_domain()
    }

    pub fn settings_in_domain(&self) -> Settings {
        let files =
            CredentialFiles { card: self.file("domain.card"), membership: self.file("membership"), peers: vec![] };
        let domain = Some(DomainConfig { files, members_only: false, trace: Inside::Masked });
        Settings(Config { udp: Some(self.addr), rib: false, domain, ..config(self.folder.path(), "switch") })
    }
}

impl Settings {
    pub fn rib(mut self) -> Self {
        self.0.rib = true;
        self
    }

    pub fn peers(mut self, certs: &[&Signed<PeerCert>]) -> Self {
        let files = &mut self.0.domain.as_mut().unwrap().files;
        for (i, cert) in certs.iter().enumerate() {
            let file = files.card.with_file_name(format!("{i}.peer"));
            std::fs::write(&file, cert.to_pem()).unwrap();
            files.peers.push(file);
        }
        self
    }

    pub fn dials(mut self, hub: &Place) -> Self {
        let place = At { switch: hub.name, via: Via::Udp(hub.addr) };
        self.0.neighbours.push(Neighbour { address: place, cost: Some(1), dial: true, parent: false, tls: None });
        self
    }

    pub async fn start(self) -> Running {
        start(self.0).await.unwrap()
    }
}

pub fn now() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs() as i64
}
