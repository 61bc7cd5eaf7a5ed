//! Dials the switch of one link.
//!
//! Selects the port and the address, and detects whether a change of the network makes another
//! attempt worthwhile.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;
use tokio::sync::watch;

use super::config::LinkConfig;
use super::error::NodeError;
use super::home::Home;
use super::network::{HostNetwork, NetworkPath, until_led};
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_core::peer::Role;
use gdp_link::link::{CloseCode, Link, LinkError, RekeySchedule};
use gdp_link::port::{Interface, LinkAddr, Port, PortConfig, interface_index};
use gdp_link::tunnel::Tunnel;

/// Maximum time for a switch's answer to discovery.
const DISCOVERY: Duration = Duration::from_secs(2);

/// Maximum number of discovery answers to try before the next discovery.
const MAX_CANDIDATES: usize = 8;

pub struct Dialler {
    pub target: LinkTarget,
    pub port: Option<Arc<Port>>,
    /// Index of the interface that the UDP port is bound to.
    pub through: Option<u32>,
    pub network: Option<Arc<HostNetwork>>,
    /// The path to the switch at the last lookup.
    pub path: NetworkPath,
    home: Arc<Home>,
    pinned: Option<Name>,
    port_config: PortConfig,
    /// Changes of the network since the start of the last attempt.
    changes: Option<watch::Receiver<()>>,
    /// The latest resolved address of the target's host, or of the proxy to it. `None` if the last
    /// lookup failed.
    address: Option<SocketAddr>,
    /// The tunnel of the current link, if the target is behind one.
    tunnel: Option<Tunnel>,
}

impl Dialler {
    pub fn new(
        (identity, run): (Identity, u64),
        home: Arc<Home>,
        lane: u8,
        config: LinkConfig,
        rekey: RekeySchedule,
        network: Option<Arc<HostNetwork>>,
    ) -> Self {
        let LinkConfig { target, switch: pinned, .. } = config;
        let through = if let LinkTarget::Udp { interface, .. } = &target { interface.clone() } else { None };
        let credentials = home.credentials.clone();
        let port_config =
            PortConfig { rekey, lane, through, run: Some(run), credentials, ..PortConfig::endpoint(identity) };
        let changes = network.as_ref().map(|network| network.changes());
        let (port, through, address, path) = (None, None, None, NetworkPath::Unknown);
        Self { target, port, through, network, path, home, pinned, port_config, changes, address, tunnel: None }
    }

    /// Returns the tunnel of the current link, if its datagrams are inside TLS.
    pub fn tunnel(&self) -> Option<&Tunnel> {
        self.tunnel.as_ref()
    }

    /// Returns the address on the network that leads to `to`: the other end of the tunnel, if there
    /// is one.
    pub fn outer(&self, to: LinkAddr) -> LinkAddr {
        self.tunnel.as_ref().map_or(to, |tunnel| LinkAddr::udp(tunnel.remote_addr()))
    }

    /// Starts an attempt, and returns the port to dial from and the candidates to dial. Later
    /// changes of the network make [`Self::news`] return.
    pub async fn begin(&mut self) -> Result<(Arc<Port>, Vec<(LinkAddr, Option<Name>)>), NodeError> {
        self.changes.as_mut().into_iter().for_each(watch::Receiver::mark_unchanged);
        if let Some(network) = self.network.clone() {
            self.path = self.look(&network).await;
        }
        self.locate().await
    }

    /// Returns whether the address of the target is unknown, so that no route to it can be looked
    /// up.
    pub fn is_blind(&self) -> bool {
        matches!(self.target, LinkTarget::Udp { .. } | LinkTarget::Tls { .. }) && self.address.is_none()
    }

    /// Returns when the network has changed such that another attempt may succeed.
    pub async fn news(&self) {
        let (Some(network), Some(changes)) = (&self.network, &self.changes) else {
            return std::future::pending().await;
        };
        if !self.is_blind() {
            return until_led(changes.clone(), self.path.clone(), || self.look(network)).await;
        }
        // Any change may provide a route to a name server that knows the address.
        if changes.clone().changed().await.is_err() {
            std::future::pending().await
        }
    }

    /// Returns the current path to the switch.
    async fn look(&self, network: &HostNetwork) -> NetworkPath {
        match &self.target {
            LinkTarget::Ethernet { interface, .. } => match interface_index(interface) {
                Ok(ifindex) => network.way(LinkAddr::Ethernet { ifindex, mac: [0; 6] }, None).await,
                Err(_) => NetworkPath::Nowhere,
            },
            LinkTarget::Udp { interface, .. } => match interface.as_deref().map(interface_index).transpose() {
                Ok(through) => match self.address {
                    Some(to) => network.way(LinkAddr::udp(to), through).await,
                    None => NetworkPath::Unknown,
                },
                Err(_) => NetworkPath::Nowhere,
            },
            LinkTarget::Tls { .. } => match self.address {
                Some(to) => network.way(LinkAddr::udp(to), None).await,
                None => NetworkPath::Unknown,
            },
        }
    }

    /// Dials the candidates in order until one is the wanted switch. Any station on the segment can
    /// answer discovery with the switch's name, so the first one that proves it counts. `apart`:
    /// frames pass through the daemon even of a switch on this host.
    pub async fn dial_first(
        &mut self,
        port: &Port,
        candidates: &[(LinkAddr, Option<Name>)],
        apart: bool,
    ) -> Result<Link, NodeError> {
        let mut failure = None;
        for (to, expected) in candidates.iter().take(MAX_CANDIDATES) {
            let dialling = async {
                match apart {
                    false => port.dial(*to, *expected).await,
                    true => port.dial_apart(*to, *expected).await,
                }
            };
            let dialled = match self.network.clone() {
                Some(network) => {
                    let outer = self.outer(*to);
                    self.path = network.way(outer, self.through).await;
                    tokio::select! {
                        dialled = dialling => dialled,
                        // Packets on the old network are lost. A new attempt is faster than waiting
                        // for a retransmission.
                        _ = network.until_other(outer, self.through, &self.path) => {
                            // The current path has not been tried. `Nowhere` makes `news` treat any
                            // path as a change.
                            self.path = NetworkPath::Nowhere;
                            return Err(NodeError::Detached("the network of this machine has changed".into()));
                        }
                    }
                }
                None => dialling.await,
            };
            match dialled {
                Ok(link) if link.peer().role == Role::Switch => match self.home.admit(&link) {
                    Ok(_) => return Ok(link),
                    Err(error) => {
                        link.refuse(CloseCode::NotAdmitted, &error.to_string());
                        failure = Some(error.into());
                    }
                },
                Ok(link) => {
                    link.refuse(CloseCode::WrongPeer, "a switch was expected");
                    failure = Some(NodeError::NotASwitch(*to));
                }
                Err(error) => failure = Some(error.into()),
            }
        }
        let discovered = matches!(self.target, LinkTarget::Ethernet { mac: None, .. });
        Err(match failure {
            Some(error) if discovered => NodeError::NoSwitch(Box::new(error)),
            Some(error) => error,
            None => NodeError::Protocol("to discovery"),
        })
    }

    /// Returns a port to dial from, and the candidates to dial. Opens another port if the interface
    /// has changed.
    async fn locate(&mut self) -> Result<(Arc<Port>, Vec<(LinkAddr, Option<Name>)>), NodeError> {
        match &self.target {
            LinkTarget::Ethernet { interface, mac } => {
                let same = |found: &Interface, port: &Port| {
                    port.interface()
                        .is_some_and(|open| (open.index, open.mac, open.mtu) == (found.index, found.mac, found.mtu))
                };
                let found = Interface::find(interface).map_err(|source| no_interface(interface, source))?;
                let port = match self.port.take().filter(|port| same(&found, port)) {
                    Some(port) => port,
                    None => Arc::new(Port::ethernet(interface, &self.port_config)?),
                };
                self.port = Some(port.clone());
                if let Some(mac) = *mac {
                    return Ok((port, vec![(LinkAddr::Ethernet { ifindex: found.index, mac }, self.pinned)]));
                }
                let answers = port.discover(self.pinned, DISCOVERY).await;
                if answers.is_empty() {
                    let wanted = self.pinned.map_or("a switch".to_owned(), |name| format!("switch {name:#}"));
                    return Err(NodeError::NoAnswer { interface: interface.clone(), wanted });
                }
                Ok((port, answers.into_iter().map(|(to, name)| (to, Some(name))).collect()))
            }
            LinkTarget::Udp { host, port: number, interface } => {
                // Looked up before a port is opened: if the interface is replaced in between, the
                // next attempt detects the other index.
                let index = match interface {
                    Some(name) => Some(interface_index(name).map_err(|source| no_interface(name, source))?),
                    None => None,
                };
                let no_address = |source| NodeError::NoAddress { host: host.clone(), source };
                self.address = None;
                let mut found = tokio::net::lookup_host((host.as_str(), *number)).await.map_err(no_address)?;
                let to = found.next().ok_or_else(|| no_address(std::io::ErrorKind::AddrNotAvailable.into()))?;
                self.address = Some(to);
                let same = |port: &Arc<Port>| {
                    self.through == index && port.udp_addr().is_some_and(|open| open.is_ipv4() == to.is_ipv4())
                };
                let port = match self.port.take().filter(same) {
                    Some(port) => port,
                    None => {
                        let any =
                            if to.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
                        Arc::new(Port::udp(SocketAddr::new(any, 0), &self.port_config)?)
                    }
                };
                (self.port, self.through) = (Some(port.clone()), index);
                Ok((port, vec![(LinkAddr::udp(to), self.pinned)]))
            }
            LinkTarget::Tls { host, port: number, websocket } => {
                (self.tunnel, self.address) = (None, None);
                let port = match self.port.take() {
                    Some(port) => port,
                    None => Arc::new(Port::udp((Ipv4Addr::LOCALHOST, 0).into(), &self.port_config)?),
                };
                self.port = Some(port.clone());
                let own = port.udp_addr().ok_or(NodeError::Protocol("to its own port"))?;
                let tunnel = Tunnel::open(host, *number, *websocket, own).await?;
                let to = LinkAddr::udp(tunnel.local_addr());
                self.address = Some(tunnel.remote_addr());
                self.tunnel = Some(tunnel);
                Ok((port, vec![(to, self.pinned)]))
            }
        }
    }
}

fn no_interface(name: &str, source: std::io::Error) -> LinkError {
    LinkError::Io { what: format!("interface {name}"), source }
}
