//! Reaches the switch of one link: by which port, at which address, and whether another network
//! would do better.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;
use tokio::sync::watch;

use super::config::LinkConfig;
use super::error::NodeError;
use super::home::Home;
use super::network::{Network, NetworkPath, until_led};
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_core::peer::Role;
use gdp_link::link::{Link, LinkError, RekeySchedule};
use gdp_link::port::{Interface, LinkAddr, Port, PortConfig, interface_index};

/// How long a switch may take to answer discovery.
const DISCOVERY: Duration = Duration::from_secs(2);

/// Answers to discovery that are tried before it is asked again.
const MAX_CANDIDATES: usize = 8;

pub struct Dialler {
    pub target: LinkTarget,
    pub port: Option<Arc<Port>>,
    /// Index of the interface that a UDP port is bound to.
    pub through: Option<u32>,
    pub network: Option<Arc<Network>>,
    /// How the switch was reached when that was last looked at.
    pub path: NetworkPath,
    home: Arc<Home>,
    pinned: Option<Name>,
    port_config: PortConfig,
    /// Of the network, since the last attempt began.
    changes: Option<watch::Receiver<()>>,
    /// What the host of a UDP target was resolved to last, unless it was not.
    address: Option<SocketAddr>,
}

impl Dialler {
    pub fn new(
        identity: Identity,
        home: Arc<Home>,
        lane: u8,
        config: LinkConfig,
        rekey: RekeySchedule,
        network: Option<Arc<Network>>,
    ) -> Self {
        let LinkConfig { target, switch: pinned, .. } = config;
        let through = if let LinkTarget::Udp { interface, .. } = &target { interface.clone() } else { None };
        let credentials = home.credentials.clone();
        let port_config = PortConfig { rekey, lane, through, credentials, ..PortConfig::endpoint(identity) };
        let changes = network.as_ref().map(|network| network.changes());
        let (port, through, address, path) = (None, None, None, NetworkPath::Unknown);
        Self { target, port, through, network, path, home, pinned, port_config, changes, address }
    }

    /// Begins an attempt: a port to dial from, and whom to dial. What the network does from now on
    /// is news.
    pub async fn begin(&mut self) -> Result<(Arc<Port>, Vec<(LinkAddr, Option<Name>)>), NodeError> {
        self.changes.as_mut().into_iter().for_each(watch::Receiver::mark_unchanged);
        if let Some(network) = self.network.clone() {
            self.path = self.look(&network).await;
        }
        self.locate().await
    }

    /// Whether nobody knows to where there should be a way.
    pub fn is_blind(&self) -> bool {
        matches!(self.target, LinkTarget::Udp { .. }) && self.address.is_none()
    }

    /// Returns when the network is such that another attempt may do better than the last.
    pub async fn news(&self) {
        let (Some(network), Some(changes)) = (&self.network, &self.changes) else {
            return std::future::pending().await;
        };
        if !self.is_blind() {
            return until_led(changes.clone(), self.path.clone(), || self.look(network)).await;
        }
        // Whatever it is, it may be the way to who knows the address.
        if changes.clone().changed().await.is_err() {
            std::future::pending().await
        }
    }

    /// How the switch would be reached now.
    async fn look(&self, network: &Network) -> NetworkPath {
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
        }
    }

    /// Anybody on the segment can answer discovery in the name of the switch: the first that proves
    /// to be it counts. `apart`: frames are to go through the daemon even of a switch on this host.
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
                    self.path = network.way(*to, self.through).await;
                    tokio::select! {
                        dialled = dialling => dialled,
                        // What went to the old network is not answered: better begun anew than said
                        // again later.
                        _ = network.until_other(*to, self.through, &self.path) => {
                            // However it is reached by now, that has not been tried: the pause is
                            // to take it for news.
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
                        link.close(&error.to_string());
                        failure = Some(error.into());
                    }
                },
                Ok(_) => failure = Some(NodeError::NotASwitch(*to)),
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

    /// A port to dial from, and whom to dial. Opens another port if the interface is not the one it
    /// was.
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
                // Before a port is opened: if it is made anew meanwhile, the next attempt finds
                // out.
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
        }
    }
}

fn no_interface(name: &str, source: std::io::Error) -> LinkError {
    LinkError::Io { what: format!("interface {name}"), source }
}
