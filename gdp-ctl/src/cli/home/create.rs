//! Makes what a domain with one server needs. Keys and choices that exist stay, so it may run
//! again. Certificates are issued anew after half of their validity.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::path::Path;

use anyhow::Context as _;
use gdp_core::cert::domain::roles;
use gdp_core::cert::{AdCert, Delegation, MemberCert, Membership, issue};
use gdp_core::identity::Identity;
use gdp_core::secret_file;
use gdp_directory::{directory_card, join_card};
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;

use super::{DAY, DomainAddress, Home};
use crate::cli::domain::{Issue, To, create_domain, quoted};
use crate::cli::issuing::validity;

/// Validity in seconds of what the domain issues to its own server.
const LIFETIME: u64 = 365 * DAY;

/// Where the switch of a new domain takes links.
const DEFAULT_UDP: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::UNSPECIFIED), 31415);

/// The choices of `gdp-ctl up`.
pub struct DomainOptions<'a> {
    /// Host, or host and port, that members dial. `None` keeps what was chosen before.
    pub at: Option<&'a str>,
    pub udp: Option<SocketAddr>,
    /// Where the switch takes links over TLS. `None` keeps what was chosen before.
    pub tls: Option<SocketAddr>,
    /// Whether links over TLS are turned off. They stay off until `tls` is set.
    pub no_tls: bool,
    /// Whether XDP is turned off. It stays off.
    pub no_xdp: bool,
    pub socket: Option<&'a Path>,
}

/// The entities of the server.
pub struct Made {
    pub domain: Name,
    pub switch: Name,
    /// Whether the domain is new.
    pub is_new: bool,
}

impl Home {
    pub fn create(&self, wanted: &DomainOptions) -> anyhow::Result<Made> {
        std::fs::create_dir_all(self.folder()).with_context(|| format!("cannot create {}", self.folder().display()))?;
        let is_new = !self.path("domain.pem").exists();
        if is_new {
            create_domain(self.folder())?;
        }
        let switch = Identity::load_or_generate(&self.path("switch.pem"), "switch")?;
        let join = Identity::load_or_generate(&self.path("join.pem"), "tool")?;
        self.admit(&switch, roles::RIB, "switch")?;
        self.admit(&join, "join", "join")?;
        self.certify_join_service(&join)?;
        let domain = self.card()?.name();
        let before = self.address().ok();
        let udp = wanted.udp.or(before.as_ref().map(|before| before.udp)).unwrap_or(DEFAULT_UDP);
        let xdp = !wanted.no_xdp && before.as_ref().is_none_or(|before| before.xdp);
        let at = match (wanted.at, &before) {
            (Some(at), _) => dialled(at, udp.port()),
            (None, Some(before)) => before.at.clone(),
            (None, None) => dialled(&own_address()?, udp.port()),
        };
        let tls = wanted.tls.or(before.as_ref().and_then(|before| before.tls)).filter(|_| !wanted.no_tls);
        let address = DomainAddress { at, switch: switch.name(), udp, tls, xdp };
        address.target()?;
        let is_same = before.as_ref() == Some(&address) && wanted.socket.is_none();
        self.replace("address", &serde_json::to_string(&address)?)?;
        // An administrator may have edited it.
        if !(is_same && self.path("gdp.yaml").exists()) {
            self.replace("gdp.yaml", &configuration(&address, wanted.socket)?)?;
        }
        Ok(Made { domain, switch: switch.name(), is_new })
    }

    fn replace(&self, name: &str, text: &str) -> anyhow::Result<()> {
        Ok(secret_file::replace(&self.path(name), text.as_bytes())?)
    }

    /// Issues the membership of an entity of this server, unless half of the last one is left.
    fn admit(&self, identity: &Identity, role: &str, label: &str) -> anyhow::Result<()> {
        let file = format!("{label}.member");
        let known = std::fs::read_to_string(self.path(&file)).ok().and_then(|text| Membership::from_pem(&text).ok());
        let until = known.and_then(|known| known.cert.claims_unverified().ok()).map_or(0, |claims| claims.not_after);
        if is_fresh(until) {
            return Ok(());
        }
        let authority = self.authority()?;
        let (not_before, not_after) = validity(LIFETIME);
        let (domain, entity, role, serial) =
            (authority.identity.name(), identity.name(), role.to_owned(), authority.serial);
        let claims = MemberCert { domain, entity, role: role.clone(), serial, not_before, not_after };
        let membership = Membership::issue(&authority.identity, &claims)?;
        let (to, label, at) = (To::Member { entity, role }, Some(label.to_owned()), Some(self.path(&file)));
        authority.remember(Issue { serial, to, label, not_before, not_after, ends: not_after, file: at })?;
        self.replace(&file, &membership.to_pem())
    }

    /// Lets the join service serve its name, publish the directory, and grant both to members.
    fn certify_join_service(&self, join: &Identity) -> anyhow::Result<()> {
        let known = self.signed::<AdCert>("join.cert").and_then(|signed| Ok(signed.claims_unverified()?));
        if known.is_ok_and(|claims| is_fresh(claims.not_after)) {
            return Ok(());
        }
        let authority = self.authority()?;
        let key = authority.identity.key();
        for (label, card) in [("directory", directory_card(key.verify_key())?), ("join", join_card(key.verify_key())?)]
        {
            let (name, serial, (not_before, not_after)) = (card.name(), authority.serial, validity(LIFETIME));
            let (entity, delegate) = (join.name(), join.key().verify_key());
            let cert = AdCert { name, entity, scope: vec![], serial, not_before, not_after };
            let delegation = Delegation { name, delegate, publish: false, read: true, serial, not_before, not_after };
            self.replace(&format!("{label}.delegation"), &issue(key, &delegation)?.to_pem())?;
            self.replace(&format!("{label}.cert"), &issue(key, &cert)?.to_pem())?;
        }
        Ok(())
    }
}

/// Whether more than half of the lifetime is left.
fn is_fresh(until: u64) -> bool {
    until.saturating_sub(LIFETIME / 2) > unix_seconds()
}

/// Returns the link that members dial, from a host with or without a port.
fn dialled(at: &str, port: u16) -> String {
    match at.parse::<IpAddr>() {
        Ok(ip) => format!("udp://{}", SocketAddr::new(ip, port)),
        Err(_) if at.contains(':') => format!("udp://{at}"),
        Err(_) => format!("udp://{at}:{port}"),
    }
}

/// Returns the address of the interface with the default route. No packet is sent.
fn own_address() -> anyhow::Result<String> {
    let address = || -> std::io::Result<IpAddr> {
        let socket = UdpSocket::bind("0.0.0.0:0")?;
        socket.connect("192.0.2.1:9")?;
        Ok(socket.local_addr()?.ip())
    };
    Ok(address().context("this machine has no default route; say what members dial with --at HOST")?.to_string())
}

fn configuration(address: &DomainAddress, socket: Option<&Path>) -> anyhow::Result<String> {
    let mut text = format!(
        "identity: switch.pem\nudp: {}\nrib: true\n\
         domain: {{card: domain.card, membership: switch.member, members_only: true}}\n",
        quoted(address.udp.to_string())
    );
    if let Some(tls) = address.tls {
        text += &format!("tls: {}\n", quoted(tls.to_string()));
    }
    if let Some(socket) = socket {
        let socket = std::path::absolute(socket).with_context(|| socket.display().to_string())?;
        text += &format!("socket: {}\n", quoted(socket.display().to_string()));
    }
    if !address.xdp {
        text += "data_plane: userspace\n";
    }
    Ok(text)
}
