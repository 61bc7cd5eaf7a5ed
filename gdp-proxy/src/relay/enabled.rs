//! The relay itself. `gdp-daemon` runs it with a configuration derived from the proxy's. The relay
//! dials the proxy's own switches and accepts links of other endpoints. It hosts no RIB.

use std::net::{IpAddr, SocketAddr};

use gdp_core::cert::domain::roles;
use gdp_core::domain::{CredentialFiles, Trust};
use gdp_core::identity::Identity;
use gdp_core::link_target::LinkTarget;
use gdp_daemon::config::{Config as SwitchConfig, DomainConfig, Inside, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve;
use gdp_daemon::serve::Running;
use gdp_wire::Name;
use tokio::runtime::{Builder, Runtime};

use crate::config::{Config, LinkEntry, RelayConfig};
use crate::material::load_identity;
use crate::material_error::{MaterialError, with_path};
use gdp_util::unix_time::unix_seconds;

/// A configured relay that is not started yet.
pub struct Relay {
    switch: SwitchConfig,
    name: Name,
}

/// A relay that runs until [`Self::stop`].
pub struct RunningRelay {
    /// The relay's own runtime, so that its traffic and the proxy's topics do not wait for each
    /// other.
    runtime: Runtime,
    running: Running,
}

/// Reasons for which a relay does not start.
#[derive(Debug, thiserror::Error)]
pub enum RelayError {
    #[error(transparent)]
    Start(#[from] serve::StartError),
    #[error("cannot start its thread: {0}")]
    Runtime(#[from] std::io::Error),
    #[error("panicked")]
    Panicked,
}

impl Relay {
    /// Reads and checks the relay's files. Returns `None` if the configuration has no relay.
    pub fn load(config: &Config) -> Result<Option<Self>, MaterialError> {
        let Some(relay) = &config.relay else { return Ok(None) };
        let wrong = |key: &str, reason| MaterialError { key: key.into(), reason };
        let identity = load_identity(&relay.identity, "switch")
            .map_err(|reason| wrong("relay.identity", with_path(reason, &relay.identity)))?;
        let neighbours = neighbours(&config.links);
        if neighbours.is_empty() {
            let reason = "the relay needs a switch to pass on to: one of these as udp://ADDRESS:PORT, without \
                          %INTERFACE, \
                          with switch: NAME";
            return Err(wrong("links", reason.into()));
        }
        let domain = config.domain.as_ref().zip(relay.membership.as_ref());
        let domain = domain.map(|(domain, membership)| {
            let files = CredentialFiles { membership: membership.clone(), ..domain.into() };
            check_membership(&files, &identity).map_err(|reason| wrong("relay.membership", reason))?;
            Ok(DomainConfig { files, members_only: true, trace: Inside::Masked })
        });
        let switch = switch(relay, neighbours, domain.transpose()?);
        Ok(Some(Self { switch, name: identity.name() }))
    }

    pub async fn start(self) -> Result<RunningRelay, RelayError> {
        let Self { switch, name } = self;
        let runtime = Builder::new_multi_thread().worker_threads(1).thread_name("relay").enable_all().build()?;
        let udp = switch.udp;
        let started = runtime.spawn(serve::start(switch)).await.map_err(|_| RelayError::Panicked);
        match started.and_then(|started| Ok(started?)) {
            Ok(running) => {
                let udp = running.udp_addr().or(udp).map_or_else(String::new, |addr| addr.to_string());
                tracing::info!(relay = %name, udp, "carries others");
                Ok(RunningRelay { runtime, running })
            }
            Err(error) => {
                runtime.shutdown_background();
                Err(error)
            }
        }
    }
}

impl RunningRelay {
    /// Notifies the attached endpoints and ends the relay.
    pub async fn stop(self) {
        if self.runtime.spawn(self.running.stop()).await.is_err() {
            tracing::error!("the relay panicked while it ended");
        }
        self.runtime.shutdown_background();
    }
}

/// Returns those of the proxy's switches that can be neighbours of a switch: they have an IP
/// address and a known name.
fn neighbours(links: &[LinkEntry]) -> Vec<Neighbour> {
    let mut neighbours: Vec<Neighbour> = Vec::new();
    for link in links {
        let (LinkTarget::Udp { host, port, interface: None }, Some(switch)) = (&link.to, link.switch) else { continue };
        let Ok(addr) = host.parse::<IpAddr>() else { continue };
        if neighbours.iter().all(|other| other.address.switch != switch) {
            let place = NeighbourAddress { switch, via: Via::Udp(SocketAddr::new(addr, *port)) };
            let over_tls =
                |other: &&LinkEntry| matches!(other.to, LinkTarget::Tls { .. }) && other.switch == Some(switch);
            let tls = links.iter().find(over_tls).map(|other| other.to.clone());
            neighbours.push(Neighbour { address: place, cost: None, dial: true, parent: false, tls });
        }
    }
    neighbours
}

/// Checks that the relay is a switch of the domain: a domain has links between its switches only.
fn check_membership(files: &CredentialFiles, identity: &Identity) -> Result<(), String> {
    let remedy = |error: String| {
        let (relay, file) = (identity.name(), files.membership.display());
        let error = with_path(error, &files.membership);
        format!(
            "{error}; the relay has to be a switch of the domain: `gdp-ctl domain admit --key DOMAIN.pem {relay} \
             --role {} \
             -o {file}`",
            roles::SWITCH
        )
    };
    let credentials = files.load().map_err(|error| remedy(error.to_string()))?;
    let trust = Trust::new(identity.name(), credentials.into(), true).map_err(|error| remedy(error.to_string()))?;
    let own = trust.own(unix_seconds()).map_err(|error| remedy(error.to_string()))?;
    match roles::is_switch(&own.role) {
        true => Ok(()),
        false => Err(remedy(format!("its role is {}", own.role))),
    }
}

fn switch(relay: &RelayConfig, neighbours: Vec<Neighbour>, domain: Option<DomainConfig>) -> SwitchConfig {
    SwitchConfig {
        interfaces: Some(relay.interfaces.clone()),
        neighbours,
        domain,
        ..SwitchConfig::userspace(relay.identity.clone(), relay.udp)
    }
}
