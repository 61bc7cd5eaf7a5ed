//! The ports that carry links.
//!
//! Opens a port and a data plane on each interface and on the UDP address. Accepts the links of
//! peers, dials the configured neighbours, and starts over when an interface is recreated.

use std::collections::HashMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use futures::StreamExt;
use gdp_core::crypto;
use gdp_core::link_target::LinkTarget;
use gdp_link::link::{Link, LinkError};
use gdp_link::port::{Interface, LinkAddr, Port};
use gdp_link::tunnel::{Tunnel, TunnelError};
use gdp_proto::admin::words::RefusedThing;
use gdp_util::backoff::{Backoff, jittered};
use gdp_wire::Name;
use tokio::sync::watch;
use tokio::time::{Instant, sleep};

use super::daemon::Daemon;
use super::start_error::StartError;
use super::{interfaces, links, liveness};
use crate::config::{Neighbour, NeighbourAddress, Via};
use gdp_dataplane::host_pair;

/// The time limit for a neighbour's answer to discovery.
const DISCOVERY: Duration = Duration::from_secs(2);

/// The maximum delay between attempts to reach a neighbour. [`RETRY`] doubles the delay from 100 ms
/// on.
const LONGEST_DELAY: Duration = Duration::from_secs(3);
const RETRY: Backoff = Backoff::new(Duration::from_millis(100), LONGEST_DELAY);

/// The delays between attempts to make a link anew that is up, but whose data plane does not
/// answer. Where only frames are blocked, each new link falls silent as well.
const LONGEST_REDIAL: Duration = Duration::from_secs(60);
const REDIAL: Backoff = Backoff::new(Duration::from_millis(10), LONGEST_REDIAL);

/// The interval of attempts over UDP while the link to a neighbour is over TLS.
const TRY_UDP: Duration = Duration::from_secs(10);

/// Opens a port on an interface and attaches the data planes to it.
pub fn open_ethernet(daemon: &Arc<Daemon>, name: &str) -> Result<Arc<Port>, StartError> {
    let port = Arc::new(Port::ethernet(name, &daemon.port_config)?);
    if let Some(interface) = port.interface() {
        daemon.core().switch.planes.attach(interface, port.data())?;
    }
    Ok(port)
}

/// Opens the UDP port. Also returns the reason why frames of local endpoints go through the daemon,
/// if they do.
pub async fn open_udp(daemon: &Arc<Daemon>, bind: SocketAddr) -> Result<(Arc<Port>, Option<String>), StartError> {
    let port = Arc::new(Port::udp(bind, &daemon.port_config)?);
    let addr = port.udp_addr().unwrap_or(bind);
    let opened = open_host_pair(daemon, addr).await;
    let no_pair = opened.as_ref().err().map(|reason| format!("endpoints on this host, because {reason}"));
    let pair = {
        let planes = &mut daemon.core().switch.planes;
        planes.attach_udp(port.data(), addr, opened.ok())?;
        planes.host_pair()
    };
    port.set_host_pair(pair);
    Ok((port, no_pair))
}

/// Opens the veth interfaces through which local endpoints reach the kernel plane. Fails with the
/// reason if there can be none.
async fn open_host_pair(daemon: &Daemon, bound: SocketAddr) -> Result<host_pair::Ends, String> {
    let possible = daemon.core().switch.planes.takes_pair(bound);
    let opened = match possible {
        Ok(()) => host_pair::open(&daemon.name).await.map_err(|error| error.to_string()),
        Err(reason) => Err(reason),
    };
    if opened.is_err() {
        remove_host_pair(daemon).await;
    }
    opened
}

/// Removes the interfaces that this or an earlier daemon created for local endpoints.
pub async fn remove_host_pair(daemon: &Daemon) {
    if let Err(error) = host_pair::remove(&daemon.name.to_string()).await {
        tracing::warn!(%error, "an interface of this switch stays");
    }
}

/// Runs the UDP port until the daemon ends.
pub async fn run_udp(daemon: Arc<Daemon>, port: Arc<Port>, bind: SocketAddr, mut changes: watch::Receiver<()>) {
    let follow_interfaces = async {
        loop {
            interfaces::look(&mut changes).await;
            refresh(&daemon);
            let pair = daemon.core().switch.planes.host_pair();
            port.set_host_pair(pair);
            if pair.is_none() {
                daemon.core().switch.close_links_by_pair();
            }
        }
    };
    let via = Via::Udp(bind);
    tokio::select! {
        () = run(&daemon, &port, &via) => {}
        () = follow_interfaces => {}
    }
}

/// Maintains a port on an interface. Reopens it after the interface was absent.
pub async fn run_ethernet(
    daemon: Arc<Daemon>,
    name: String,
    mut port: Option<Arc<Port>>,
    mut changes: watch::Receiver<()>,
) {
    loop {
        let open = match port.take() {
            Some(port) => port,
            None => match open_ethernet(&daemon, &name) {
                Ok(port) => {
                    let planes = daemon.core().switch.planes.report();
                    planes.iter().filter(|plane| plane.interface == name).for_each(|plane| plane.log());
                    port
                }
                Err(error) => {
                    tracing::debug!(interface = name, %error, "not usable yet");
                    interfaces::look(&mut changes).await;
                    continue;
                }
            },
        };
        daemon.ports().insert(name.clone(), open.clone());
        let via = Via::Interface(name.clone());
        let change = tokio::select! {
            () = run(&daemon, &open, &via) => "the port has ended".to_owned(),
            change = interface_changed(&daemon, &open, &mut changes) => change,
        };
        tracing::warn!(interface = name, "{change}; its links end, and are made again when it can carry them");
        daemon.ports().remove(&name);
        open.close(&change).await;
        if let Some(interface) = open.interface() {
            daemon.core().switch.planes.detach(interface.index);
        }
    }
}

/// Waits until the opened interface cannot be used as it was opened. Returns why.
async fn interface_changed(daemon: &Arc<Daemon>, port: &Port, changes: &mut watch::Receiver<()>) -> String {
    let Some(opened) = port.interface() else { return std::future::pending().await };
    loop {
        interfaces::look(changes).await;
        match Interface::find(&opened.name) {
            Err(_) => return "the interface is gone".into(),
            Ok(now) if now.index != opened.index => return "the interface was made anew".into(),
            Ok(now) if now.mac != opened.mac => return "the interface has another MAC address".into(),
            Ok(now) if now.mtu != opened.mtu => {
                return format!("the MTU of the interface has changed from {} to {}", opened.mtu, now.mtu);
            }
            Ok(_) => {}
        }
        refresh(daemon);
    }
}

fn refresh(daemon: &Daemon) {
    if let Err(error) = daemon.core().switch.planes.refresh() {
        tracing::error!(%error, "the data planes could not be refreshed");
    }
}

async fn run(daemon: &Arc<Daemon>, port: &Arc<Port>, via: &Via) {
    let own = daemon.name;
    // Of two neighbours, the one with the smaller name dials, unless the configuration sets `dial`.
    let to_dial: Vec<Neighbour> = {
        let core = daemon.core();
        let near = core.neighbours.listed.iter().filter(|n| n.address.via.same_port(via));
        near.filter(|n| n.dial || own.as_bytes() < n.address.switch.as_bytes()).cloned().collect()
    };
    let dials = futures::future::join_all(to_dial.into_iter().map(|neighbour| {
        let NeighbourAddress { switch, via } = neighbour.address;
        keep_link(daemon, port, switch, [Some(via), neighbour.tls.map(Via::Tls)].into_iter().flatten().collect())
    }));
    tokio::join!(accept(daemon, port, via), dials);
}

async fn accept(daemon: &Arc<Daemon>, port: &Port, via: &Via) {
    while let Some(result) = port.accept().await {
        match result {
            // The answer of the RIB, or of another program with the same key, may take time.
            Ok(link) if links::must_ask(daemon, &link) => {
                let (daemon, via) = (daemon.clone(), via.clone());
                daemon.clone().spawn(async move { take(&daemon, link, via).await });
            }
            Ok(link) => take(daemon, link, via.clone()).await,
            Err(error) => tracing::debug!(%via, %error, "a peer did not get a link"),
        }
    }
}

async fn take(daemon: &Arc<Daemon>, link: Link, via: Via) {
    let peer = link.peer().name;
    if let Err(reason) = links::take(daemon, link, via.clone()).await {
        let line = {
            let (switch, now) = (&mut daemon.core().switch, std::time::Instant::now());
            switch.recent_refusals.add(peer, RefusedThing::Link, None, &reason, now);
            let is_new = switch.refused(peer, &via, &reason);
            is_new.then(|| switch.recent_refusals.line(RefusedThing::Link, now)).flatten()
        };
        if let Some(suppressed) = line {
            tracing::warn!(peer = %format_args!("{peer:#}"), %reason, suppressed, "refused a link");
        }
    }
}

/// Maintains the link to a neighbour, and dials again whenever it is lost.
///
/// Starts with the path that worked last, and tries the next one after each failure. Delays the
/// attempt after a link that did not last, as when the neighbour refuses it. Returns at once if
/// there is no path.
pub(super) async fn keep_link(daemon: &Arc<Daemon>, port: &Port, switch: Name, ways: Vec<Via>) {
    let (mut retry, mut redial, mut told) = (RETRY, REDIAL, HashMap::new());
    let mut turns = ways.iter().cycle().peekable();
    while let Some(via) = turns.peek().copied() {
        let existing = daemon.core().switch.link_to(&switch);
        let problem = match existing {
            Some(link) => {
                let up = Instant::now();
                let reason = tokio::select! {
                    biased;
                    preferred = answers_over_udp(port, switch, &ways), if matches!(via, Via::Tls(_)) => {
                        turns = ways.iter().cycle().peekable();
                        match links::take(daemon, preferred, ways[0].clone()).await {
                            Ok(()) => continue,
                            Err(reason) => format!("refused a link: {reason}"),
                        }
                    }
                    link = dial_when_silent(daemon, port, &link, via, &mut redial), if !matches!(via, Via::Tls(_)) => {
                        match links::take(daemon, link, via.clone()).await {
                            Ok(()) => continue,
                            Err(reason) => format!("refused a link: {reason}"),
                        }
                    }
                    reason = link.closed() => reason,
                };
                // The other side may have closed it because the one over UDP came.
                if matches!(via, Via::Tls(_)) && reason.contains("replaced") {
                    turns = ways.iter().cycle().peekable();
                }
                if up.elapsed() > LONGEST_DELAY {
                    retry.reset();
                }
                if up.elapsed() > 2 * LONGEST_REDIAL {
                    redial.reset();
                }
                reason
            }
            None => {
                let problem = match dial(daemon, port, switch, via).await {
                    Ok(link) => match links::take(daemon, link, via.clone()).await {
                        Ok(()) => continue,
                        Err(reason) => format!("refused a link: {reason}"),
                    },
                    Err(error) => error.to_string(),
                };
                turns.next();
                problem
            }
        };
        if told.insert(via, problem.clone()).is_none_or(|before| before != problem) {
            daemon.core().switch.refused(switch, via, &problem);
            tracing::warn!(switch = %format_args!("{switch:#}"), %via, "no link: {problem}; trying on");
        }
        // Jitter keeps neighbours that start together from dialling in step.
        let random = crypto::random::<1>().map_or(0, |[byte]| byte);
        sleep(jittered(retry.next_delay(), random)).await;
    }
}

/// Waits until the data plane at the other end of a link does not answer, and makes another link as
/// soon as the switch can be reached. It may have lost its state, or have another MAC address,
/// which QUIC notices after seconds. The silent link stays until then.
async fn dial_when_silent(daemon: &Daemon, port: &Port, link: &Link, via: &Via, delay: &mut Backoff) -> Link {
    let switch = link.peer().name;
    loop {
        liveness::until_silent(daemon, link).await;
        sleep(delay.next_delay()).await;
        if daemon.core().switch.answers(link) {
            continue;
        }
        match dial(daemon, port, switch, via).await {
            Ok(link) => return link,
            Err(error) => tracing::debug!(switch = %format_args!("{switch:#}"), %error, "it does not answer either"),
        }
    }
}

/// Waits until the switch answers over UDP, and returns the link. The link over TLS stays until
/// then.
async fn answers_over_udp(port: &Port, switch: Name, ways: &[Via]) -> Link {
    loop {
        sleep(TRY_UDP).await;
        if let Some(Via::Udp(addr)) = ways.first()
            && let Ok(link) = port.dial(LinkAddr::udp(*addr), Some(switch)).await
        {
            return link;
        }
    }
}

async fn dial(daemon: &Daemon, port: &Port, switch: Name, via: &Via) -> Result<Link, DialError> {
    match via {
        Via::Udp(addr) => Ok(port.dial(LinkAddr::udp(*addr), Some(switch)).await?),
        Via::Interface(_) => Ok(port.dial(find(port, switch).await?, Some(switch)).await?),
        Via::Tls(LinkTarget::Tls { host, port: number, websocket }) => {
            let own = port.udp_addr().map(reached_at).ok_or(DialError::NoPort)?;
            let tunnel = Tunnel::open(host, *number, *websocket, own).await?;
            let link = port.dial(LinkAddr::udp(tunnel.local_addr()), Some(switch)).await?;
            let ended = link.clone();
            daemon.spawn(async move {
                tokio::select! {
                    () = tunnel.ended() => ended.close("the TLS connection to the switch has ended"),
                    _ = ended.closed() => {}
                }
            });
            Ok(link)
        }
        Via::Tls(_) => Err(DialError::NoPort),
    }
}

/// Returns where programs on this host reach a port.
fn reached_at(bound: SocketAddr) -> SocketAddr {
    let ip = if bound.ip().is_unspecified() { Ipv4Addr::LOCALHOST.into() } else { bound.ip() };
    SocketAddr::new(ip, bound.port())
}

/// The reason why a neighbour was not reached.
#[derive(Debug, thiserror::Error)]
enum DialError {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Tunnel(#[from] TunnelError),
    #[error("a tunnel over TLS starts at the UDP port, and this is another")]
    NoPort,
}

async fn find(port: &Port, switch: Name) -> Result<LinkAddr, LinkError> {
    let answers = port.discover(Some(switch), DISCOVERY).await;
    let found = answers.into_iter().find(|(_, name)| *name == switch);
    let silent = || LinkError::Timeout { what: "a neighbour's answer to discovery", after: DISCOVERY };
    found.map(|(addr, _)| addr).ok_or_else(silent)
}

/// Returns a receiver that is notified when interfaces change.
pub fn watch_interfaces(daemon: &Arc<Daemon>) -> watch::Receiver<()> {
    let (sender, receiver) = watch::channel(());
    match interfaces::changes() {
        Ok(mut changes) => daemon.spawn(async move {
            while changes.next().await.is_some() {
                let _ = sender.send(());
            }
        }),
        Err(error) => {
            tracing::warn!(%error, "no news of interfaces from the kernel; looking every {} s", interfaces::LOOK.as_secs());
            daemon.spawn(async move {
                sender.closed().await;
            });
        }
    }
    receiver
}
