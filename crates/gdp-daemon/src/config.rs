//! The daemon's configuration file, and the defaults without one. The format is strict YAML:
//! unknown keys are errors. The daemon reads it once at start. Paths in it are relative to its
//! folder.

mod domain;
mod dpdk;
mod etcd;
mod listen;
mod neighbour;

use std::collections::HashSet;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

use gdp_core::cert::MAX_ADDRESSES;
use gdp_core::crypto::Backend;
use gdp_core::file_kind::FileKind;
use gdp_http::parse_address;
use gdp_link::link::RekeySchedule;
use gdp_util::{text_file, yaml};
use schemars::JsonSchema;
use serde::Deserialize;

use self::domain::DomainEntry;
pub use self::domain::{DomainConfig, Inside};
use self::dpdk::DpdkEntry;
pub use self::etcd::EtcdConfig;
use self::etcd::EtcdEntry;
use self::listen::{UdpConfig, parse_tls};
use self::neighbour::NeighbourAddressEntry;
pub use self::neighbour::{Neighbour, NeighbourAddress, Via};
use gdp_dataplane::FIB_CAPACITY;
use gdp_dataplane::dpdk::DpdkConfig;
use gdp_dataplane::pins::BPFFS;
use gdp_util::folders;

/// The maximum size of the file, in bytes. A configuration is a page of text, so a larger file is
/// the wrong one.
const MAX_FILE: u64 = 256 * 1024;

/// The configuration of `gdp-ctl serve`.
#[derive(Clone, Debug)]
pub struct Config {
    /// The file of the switch's private key. The daemon generates a missing one.
    pub identity: PathBuf,
    /// The path of the admin socket, which this process's user and group may use.
    pub socket: PathBuf,
    /// The Ethernet interfaces that carry links directly. `None`: those that other keys name. See
    /// [`Config::named_interfaces`].
    pub interfaces: Option<Vec<String>>,
    /// Uses every Ethernet interface that is up at start. Not an option of the file.
    pub all_interfaces: bool,
    /// Whether the kernel forwards on after this daemon. Then what a daemon of another version left
    /// there is removed at start. Not an option of the file.
    pub keep: bool,
    /// The address that accepts links over UDP, if any.
    pub udp: Option<SocketAddr>,
    /// The TCP address that accepts links over TLS, if any.
    pub tls: Option<SocketAddr>,
    pub data_plane: DataPlane,
    /// The settings of the DPDK plane.
    pub dpdk: DpdkConfig,
    /// Whether this daemon is the RIB. If not, the topology leads to it.
    pub rib: bool,
    pub neighbours: Vec<Neighbour>,
    pub ebpf_object: Option<PathBuf>,
    pub fib_capacity: u32,
    /// The BPF file system in which XDP outlives the daemon. `None`: XDP ends with the daemon.
    pub bpffs: Option<PathBuf>,
    /// The trust domain of the switch. Without one, it accepts any configured neighbour and any
    /// endpoint.
    pub domain: Option<DomainConfig>,
    /// The addresses at which borders of other domains reach this border, best first.
    pub public: Vec<SocketAddr>,
    /// The store of the RIB, if it is one of several replicas.
    pub etcd: Option<EtcdConfig>,
    /// The address that serves metrics, if any.
    pub metrics: Option<SocketAddr>,
    /// The file of the token that a scrape of the metrics needs. `None`: everybody on this machine.
    pub metrics_token: Option<PathBuf>,
    /// The back end of cryptography, if it is not the default one.
    pub crypto: Option<Backend>,
    /// The schedule of link key rotation. Not an option of the file.
    pub rekey: RekeySchedule,
}

/// The data plane that the user selects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum DataPlane {
    /// XDP where it attaches, else the userspace plane.
    #[default]
    Auto,
    /// XDP on every Ethernet interface, or no start.
    Xdp,
    /// DPDK on the devices that the configuration lists for it, or no start.
    Dpdk,
    /// The userspace plane alone.
    Userspace,
}

/// The reason why a configuration is refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("cannot read the configuration {}: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error("{}: {reason}", path.display())]
    Invalid { path: PathBuf, reason: String },
    #[error("{0}")]
    Folder(#[from] folders::NoFolder),
}

impl Config {
    /// Returns an unprivileged switch on this UDP address alone, without RIB or neighbours. Callers
    /// set the other fields as needed.
    pub fn userspace(identity: PathBuf, udp: SocketAddr) -> Self {
        Self {
            socket: identity.with_extension("sock"),
            identity,
            interfaces: Some(Vec::new()),
            all_interfaces: false,
            keep: false,
            udp: Some(udp),
            tls: None,
            data_plane: DataPlane::Userspace,
            dpdk: DpdkConfig::default(),
            rib: false,
            neighbours: Vec::new(),
            ebpf_object: None,
            fib_capacity: FIB_CAPACITY,
            bpffs: None,
            domain: None,
            public: Vec::new(),
            etcd: None,
            metrics: None,
            metrics_token: None,
            crypto: None,
            rekey: RekeySchedule::default(),
        }
    }

    /// Returns the configuration of a daemon without a file: RIB and switch, with links over UDP.
    pub fn embedded() -> Result<Self, ConfigError> {
        Ok(Self {
            socket: folders::admin_socket()?,
            interfaces: None,
            data_plane: DataPlane::Auto,
            rib: true,
            bpffs: default_bpffs(),
            ..Self::userspace(folders::state()?.join("switch.pem"), default_udp())
        })
    }

    /// Returns the named Ethernet interfaces, each once. They are those of `interfaces`. Without
    /// that list, they are those of neighbours and of DPDK's ports in use.
    pub fn named_interfaces(&self) -> Vec<String> {
        let neighbours = self.neighbours.iter().filter_map(|neighbour| match &neighbour.address.via {
            Via::Interface(name) => Some(name),
            Via::Udp(_) | Via::Tls(_) => None,
        });
        let is_dpdk = self.data_plane == DataPlane::Dpdk;
        let ports = self.dpdk.ports.iter().filter(|_| is_dpdk).map(|port| &port.interface);
        let named: Vec<&String> = match &self.interfaces {
            Some(listed) => listed.iter().collect(),
            None => ports.chain(neighbours).collect(),
        };
        let mut once = HashSet::new();
        named.into_iter().filter(|name| once.insert(*name)).cloned().collect()
    }

    /// Adds further named interfaces.
    pub fn name_interfaces(&mut self, more: Vec<String>) {
        let named = [self.named_interfaces(), more].concat();
        self.interfaces = Some(named);
    }

    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let io = |source| ConfigError::Io { path: path.into(), source };
        let folder = path.parent().unwrap_or(Path::new(""));
        let Some(text) = text_file::read(path, MAX_FILE).map_err(io)? else {
            let reason = format!("longer than {MAX_FILE} bytes, so not a configuration");
            return Err(ConfigError::Invalid { path: path.into(), reason });
        };
        Self::parse(&text, folder).map_err(|error| match error {
            ParseError::Invalid(reason) => ConfigError::Invalid { path: path.into(), reason },
            ParseError::Folder(error) => error.into(),
        })
    }

    fn parse(text: &str, folder: &Path) -> Result<Self, ParseError> {
        let file: File = if text.trim().is_empty() {
            File { bpffs: default_bpffs(), ..File::default() }
        } else {
            yaml::parse(text).map_err(|reason| match FileKind::of(text) {
                Some(kind) => ParseError::Invalid(format!("it is {kind}, not a daemon's configuration")),
                None => ParseError::Invalid(reason),
            })?
        };
        file.check(folder)
    }
}

#[derive(Debug)]
enum ParseError {
    Invalid(String),
    Folder(folders::NoFolder),
}

impl From<folders::NoFolder> for ParseError {
    fn from(error: folders::NoFolder) -> Self {
        Self::Folder(error)
    }
}

/// The schema of the file.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct File {
    /// The file of the switch's private key, which is created if it does not exist. By default
    /// `/var/lib/gdp/switch.pem` for root, else `~/.local/state/gdp/switch.pem`.
    identity: Option<PathBuf>,
    /// The path of the admin socket. By default `/run/gdp/ctl.sock` for root, else
    /// `$XDG_RUNTIME_DIR/gdp/ctl.sock`.
    socket: Option<PathBuf>,
    /// Ethernet interfaces with links of their own, and with XDP whatever it disturbs. By default
    /// those that other keys name. `--interface` adds to them.
    interfaces: Option<Vec<String>>,
    /// Address and port of links over UDP, by default `0.0.0.0:31415`. `null` turns UDP off.
    #[schemars(with = "Option<String>")]
    udp: UdpConfig,
    /// TCP address and port of links over TLS, such as `0.0.0.0:443`, for networks without UDP. It
    /// needs `udp`.
    tls: Option<String>,
    /// The data plane, by default `auto`.
    data_plane: DataPlane,
    /// The devices and the resources of the DPDK plane.
    dpdk: DpdkEntry,
    /// Whether this daemon is the RIB. By default it is, unless it has an `uplink`.
    rib: Option<bool>,
    /// A neighbour like the others. If it is set, the RIB is elsewhere.
    uplink: Option<NeighbourAddressEntry>,
    /// The switches to have links with.
    neighbours: Vec<NeighbourAddressEntry>,
    /// Another file with the XDP programs than the executable contains.
    ebpf_object: Option<PathBuf>,
    /// The largest number of names in the FIB, from 1 to 16777216; by default 65536.
    fib_capacity: Option<u32>,
    /// The BPF file system in which XDP outlives the daemon. `null` turns that off.
    #[serde(default = "default_bpffs")]
    bpffs: Option<PathBuf>,
    /// Membership of a trust domain.
    domain: Option<DomainEntry>,
    /// Addresses where other domains reach this border, best first.
    #[schemars(with = "Vec<String>")]
    public: Vec<SocketAddr>,
    /// The store of RIB replicas.
    etcd: Option<EtcdEntry>,
    /// Address and port of metrics in OpenMetrics, such as `127.0.0.1:9404`, or a port alone for
    /// loopback. Off by default.
    metrics: Option<String>,
    /// File of the token that a scrape needs: `Authorization: Bearer TOKEN`. An address that other
    /// machines reach needs one.
    metrics_token: Option<PathBuf>,
    /// What verifies certificates, if it is not the default: `aws-lc`, or `rustcrypto`, which is
    /// all Rust.
    #[schemars(with = "Option<String>")]
    crypto: Option<Backend>,
}

impl File {
    fn check(self, folder: &Path) -> Result<Config, ParseError> {
        let invalid = |reason: String| Err(ParseError::Invalid(reason));
        let mut neighbours = Vec::new();
        for entry in self.neighbours {
            let neighbour = entry.neighbour("neighbours").map_err(ParseError::Invalid)?;
            if neighbours.iter().any(|n: &Neighbour| n.address.switch == neighbour.address.switch) {
                return invalid(format!("neighbours: {} is listed twice", neighbour.address.switch));
            }
            neighbours.push(neighbour);
        }
        let uplink_cost = self.uplink.as_ref().and_then(|entry| entry.cost);
        let uplink = self.uplink.map(|entry| entry.neighbour("uplink")).transpose().map_err(ParseError::Invalid)?;
        let rib = self.rib.unwrap_or(uplink.is_none());
        match &uplink {
            Some(_) if rib => {
                return invalid("uplink: this daemon is the RIB (rib: true); remove one of the two".into());
            }
            None if !rib && neighbours.is_empty() => {
                return invalid(
                    "rib: false needs a neighbour by which the RIB is reached: neighbours: [{interface: …, switch: …}]"
                        .into(),
                );
            }
            _ => {}
        }
        if let Some(uplink) = uplink {
            let switch = uplink.address.switch;
            match neighbours.iter_mut().find(|n| n.address.switch == switch) {
                Some(listed) if listed.address != uplink.address => {
                    return invalid(format!("uplink: {switch} is another place in neighbours"));
                }
                Some(listed) if uplink_cost.is_some() && uplink_cost != listed.cost => {
                    return invalid(format!("uplink: {switch} has another cost in neighbours; remove one of the two"));
                }
                Some(listed) => listed.dial |= uplink.dial,
                None => neighbours.push(uplink),
            }
        }
        if let (UdpConfig::Off, Some(over_udp)) =
            (&self.udp, neighbours.iter().find(|n| matches!(n.address.via, Via::Udp(_))))
        {
            let switch = over_udp.address.switch;
            return invalid(format!("udp: null turns UDP off, but the neighbour {switch} is reached over it"));
        }
        let tls = self.tls.map(|text| parse_tls(&text)).transpose().map_err(ParseError::Invalid)?;
        if tls.is_some() && matches!(self.udp, UdpConfig::Off) {
            return invalid("tls: links over TLS need the UDP port, which udp: null turns off; remove one".into());
        }
        if let (Some(_), UdpConfig::On(udp)) = (tls, &self.udp)
            && udp.is_ipv6()
            && !udp.ip().is_unspecified()
        {
            return invalid("tls: links over TLS need a UDP port that takes IPv4; set udp: '[::]:31415'".into());
        }
        if let Some(interfaces) = &self.interfaces {
            for neighbour in &neighbours {
                if let Via::Interface(name) = &neighbour.address.via
                    && !interfaces.contains(name)
                {
                    return invalid(format!(
                        "neighbours: {} is on {name}, which interfaces does not list",
                        neighbour.address.switch
                    ));
                }
            }
        }
        let fib_capacity = self.fib_capacity.unwrap_or(FIB_CAPACITY);
        if !(1..=1 << 24).contains(&fib_capacity) {
            return invalid(format!("fib_capacity: {fib_capacity} is not between 1 and {}", 1 << 24));
        }
        if let Some(domain) = &self.domain {
            domain.check().map_err(ParseError::Invalid)?;
        }
        if self.public.len() > MAX_ADDRESSES {
            return invalid(format!("public: {} addresses, where at most {MAX_ADDRESSES} are told", self.public.len()));
        }
        let etcd = self.etcd.map(|entry| entry.check(rib, folder)).transpose().map_err(ParseError::Invalid)?;
        let dpdk = self.dpdk.check().map_err(ParseError::Invalid)?;
        if self.data_plane == DataPlane::Dpdk && dpdk.ports.is_empty() {
            return invalid(
                "data_plane: dpdk needs devices: dpdk: {ports: [{interface: gdp0, device: 0000:02:00.0}]}".into(),
            );
        }
        let metrics = self.metrics.map(|text| parse_address(&text)).transpose();
        let metrics = metrics.map_err(|error| ParseError::Invalid(format!("metrics: {error}")))?;
        let here = |path: PathBuf| folder.join(path);
        Ok(Config {
            metrics,
            metrics_token: self.metrics_token.map(here),
            identity: match self.identity {
                Some(path) => here(path),
                None => folders::state()?.join("switch.pem"),
            },
            socket: match self.socket {
                Some(path) => here(path),
                None => folders::admin_socket()?,
            },
            interfaces: self.interfaces,
            all_interfaces: false,
            keep: false,
            udp: match self.udp {
                UdpConfig::Absent => Some(default_udp()),
                UdpConfig::Off => None,
                UdpConfig::On(addr) => Some(addr),
            },
            tls,
            data_plane: self.data_plane,
            dpdk,
            rib,
            neighbours,
            ebpf_object: self.ebpf_object.map(here),
            fib_capacity,
            bpffs: self.bpffs.map(here),
            public: self.public,
            crypto: self.crypto,
            domain: self.domain.map(|entry| entry.within(folder)),
            etcd,
            rekey: RekeySchedule::default(),
        })
    }
}

fn default_bpffs() -> Option<PathBuf> {
    Some(BPFFS.into())
}

/// Returns the default address for links over UDP.
pub fn default_udp() -> SocketAddr {
    (Ipv4Addr::UNSPECIFIED, gdp_wire::UDP_PORT).into()
}

#[cfg(test)]
#[path = "../tests/unit/config.rs"]
mod tests;
