//! Makes what a domain with one server needs. Keys and choices that exist stay, so it may run
//! again, also without the domain's key.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::path::Path;

use anyhow::Context as _;
use gdp_core::identity::Identity;
use gdp_core::secret_file::{self, OF_ROOT};
use gdp_util::ownership;
use gdp_wire::Name;

use super::renewals::{OWN, SWITCH};
use super::{DomainAddress, Home, default_lifetime};
use crate::cli::domain::{create_domain, quoted};

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
    /// Seconds for which a membership lasts without a renewal. `None` keeps what was chosen before.
    pub lifetime: Option<u64>,
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
        let is_new = !self.path("domain.card").exists();
        let cannot = || format!("cannot create {}", self.folder().display());
        std::fs::create_dir_all(self.folder()).with_context(cannot)?;
        if is_new {
            create_domain(self.folder(), Some(&self.path("successor.pem")))?;
        }
        let before = if self.path("address").exists() { Some(self.address()?) } else { None };
        let lifetime =
            wanted.lifetime.or(before.as_ref().map(|before| before.lifetime)).unwrap_or_else(default_lifetime);
        let switch = Identity::load_or_generate(&self.path("switch.pem"), "switch")?;
        let join = Identity::load_or_generate(&self.path("join.pem"), "tool")?;
        for own in OWN {
            let identity = if own.label == SWITCH.label { &switch } else { &join };
            if !self.is_admitted(own)? {
                self.admit(identity.name(), own, lifetime)?;
            }
        }
        let domain = self.card()?.name();
        let udp = wanted.udp.or(before.as_ref().map(|before| before.udp)).unwrap_or(DEFAULT_UDP);
        let xdp = !wanted.no_xdp && before.as_ref().is_none_or(|before| before.xdp);
        let at = match (wanted.at, &before) {
            (Some(at), _) => dialled(at, udp.port()),
            (None, Some(before)) => before.at.clone(),
            (None, None) => dialled(&own_address()?, udp.port()),
        };
        let tls = wanted.tls.or(before.as_ref().and_then(|before| before.tls)).filter(|_| !wanted.no_tls);
        let address = DomainAddress { at, switch: switch.name(), udp, tls, xdp, lifetime };
        address.target()?;
        let is_same = before.as_ref() == Some(&address) && wanted.socket.is_none();
        self.replace("address", &serde_json::to_string(&address)?)?;
        // An administrator may have edited it.
        if !(is_same && self.path("gdp.yaml").exists()) {
            self.replace("gdp.yaml", &configuration(&address, wanted.socket)?)?;
        }
        // The programs of the domain run as that user. The domain's keys remain root's.
        ownership::give_all(self.folder(), &OF_ROOT)
            .with_context(|| format!("{}: its owner", self.folder().display()))?;
        Ok(Made { domain, switch: switch.name(), is_new })
    }

    pub(super) fn replace(&self, name: &str, text: &str) -> anyhow::Result<()> {
        Ok(secret_file::replace(&self.path(name), text.as_bytes())?)
    }
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
