//! Linux's notifications and routes, by netlink.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use futures::{StreamExt, TryStreamExt};
use netlink_packet_core::NetlinkPayload;
use netlink_packet_route::RouteNetlinkMessage;
use netlink_packet_route::link::{LinkFlags, LinkMessage};
use netlink_packet_route::route::{RouteAddress, RouteAttribute, RouteMessage, RouteType};
use parking_lot::Mutex;
use rtnetlink::{Handle, MulticastGroup, RouteMessageBuilder};
use tokio::sync::watch;
use tokio::time::timeout;

use super::{Exit, NetworkPath, until_other};
use crate::node::abort_on_drop::AbortOnDrop;
use gdp_link::port::LinkAddr;

/// The netlink groups that the node listens to.
const GROUPS: [MulticastGroup; 5] = [
    MulticastGroup::Link,
    MulticastGroup::Ipv4Ifaddr,
    MulticastGroup::Ipv6Ifaddr,
    MulticastGroup::Ipv4Route,
    MulticastGroup::Ipv6Route,
];

/// Maximum time for an answer of the kernel. The kernel answers at once except during a large
/// reconfiguration.
const TIMEOUT: Duration = Duration::from_secs(1);

/// The network of this machine, in the network namespace of the runtime when it was opened.
pub struct HostNetwork {
    handle: Handle,
    carriers: Arc<Mutex<Carriers>>,
    changes: watch::Receiver<()>,
    _tasks: [AbortOnDrop; 2],
}

impl HostNetwork {
    /// Starts to listen for notifications, each of which notifies the receivers of `told`. Call
    /// within a tokio runtime.
    pub fn open(told: watch::Sender<()>) -> std::io::Result<Self> {
        let (connection, handle, mut messages) = rtnetlink::new_multicast_connection(&GROUPS)?;
        let changes = told.subscribe();
        let carriers = Arc::<Mutex<Carriers>>::default();
        let kept = carriers.clone();
        let listening = tokio::spawn(async move {
            while let Some((message, _)) = messages.next().await {
                match message.payload {
                    NetlinkPayload::InnerMessage(RouteNetlinkMessage::NewLink(link)) => kept.lock().take(&link),
                    NetlinkPayload::InnerMessage(RouteNetlinkMessage::DelLink(link)) => kept.lock().removed(&link),
                    _ => {}
                }
                told.send_replace(());
            }
        });
        let tasks = [tokio::spawn(connection), listening].map(AbortOnDrop);
        Ok(Self { handle, carriers, changes, _tasks: tasks })
    }

    /// Returns a receiver that is notified of every change.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.changes.clone()
    }

    /// Returns the path to `to`, only through the interface `through` if given.
    pub async fn way(&self, to: LinkAddr, through: Option<u32>) -> NetworkPath {
        let (interface, source, router) = match to {
            LinkAddr::Ethernet { ifindex, .. } => (ifindex, None, None),
            LinkAddr::Udp(to) => match self.route(to.ip().to_canonical(), through).await {
                Answer::Route(route) => route,
                Answer::NoRoute => return NetworkPath::Nowhere,
                Answer::None => return NetworkPath::Unknown,
            },
        };
        match self.carriers.lock().of(interface) {
            Some(carrier) => NetworkPath::By(Exit { interface, carrier, source, router }),
            None => NetworkPath::Nowhere,
        }
    }

    /// Returns the path to `to` when it differs from `before`; see [`until_other`].
    pub async fn until_other(&self, to: LinkAddr, through: Option<u32>, before: &NetworkPath) -> NetworkPath {
        until_other(self.changes(), before.clone(), || self.way(to, through)).await
    }

    async fn route(&self, to: IpAddr, through: Option<u32>) -> Answer {
        let bits = if to.is_ipv4() { 32 } else { 128 };
        let Ok(mut asked) = RouteMessageBuilder::<IpAddr>::new().destination_prefix(to, bits) else {
            return Answer::None;
        };
        if let Some(interface) = through {
            asked = asked.output_interface(interface);
        }
        let mut answers = std::pin::pin!(self.handle.route().get(asked.build()).execute());
        Answer::of(answers.try_next()).await
    }
}

/// The kernel's answer about a route.
#[derive(Debug, PartialEq, Eq)]
enum Answer {
    /// Interface, source and router.
    Route((u32, Option<IpAddr>, Option<IpAddr>)),
    NoRoute,
    /// No answer in time, or an error other than a missing route.
    None,
}

impl Answer {
    async fn of(asked: impl Future<Output = Result<Option<RouteMessage>, rtnetlink::Error>>) -> Self {
        match timeout(TIMEOUT, asked).await {
            Ok(Ok(Some(route))) => Self::from(&route),
            Ok(Err(rtnetlink::Error::NetlinkError(error))) if is_no_route(-error.raw_code()) => Self::NoRoute,
            Ok(Err(error)) => {
                tracing::debug!(%error, "the kernel does not say how an address is reached");
                Self::None
            }
            Ok(Ok(None)) | Err(_) => {
                tracing::debug!("the kernel does not answer how an address is reached");
                Self::None
            }
        }
    }
}

impl From<&RouteMessage> for Answer {
    fn from(route: &RouteMessage) -> Self {
        if matches!(route.header.kind, RouteType::BlackHole | RouteType::Unreachable | RouteType::Prohibit) {
            return Self::NoRoute;
        }
        let (mut interface, mut source, mut router) = (None, None, None);
        for attribute in &route.attributes {
            match attribute {
                RouteAttribute::Oif(index) => interface = Some(*index),
                RouteAttribute::PrefSource(address) => source = ip(address),
                RouteAttribute::Gateway(address) => router = ip(address),
                _ => {}
            }
        }
        interface.map_or(Self::None, |interface| Self::Route((interface, source, router)))
    }
}

/// Returns whether this error means that there is no route now. Other errors mean other failures.
fn is_no_route(errno: i32) -> bool {
    // The kernel returns ENODEV for a removed interface.
    matches!(errno, libc::ENETUNREACH | libc::EHOSTUNREACH | libc::EACCES | libc::ENODEV)
}

fn ip(address: &RouteAddress) -> Option<IpAddr> {
    match address {
        RouteAddress::Inet(address) => Some((*address).into()),
        RouteAddress::Inet6(address) => Some((*address).into()),
        _ => None,
    }
}

/// The carrier of each interface and the number of its changes. An interface without notifications
/// counts as having a carrier.
#[derive(Debug, Default)]
struct Carriers(HashMap<u32, (bool, u64)>);

impl Carriers {
    fn take(&mut self, link: &LinkMessage) {
        self.set(link.header.index, link.header.flags.contains(LinkFlags::Up | LinkFlags::LowerUp));
    }

    fn removed(&mut self, link: &LinkMessage) {
        self.set(link.header.index, false);
    }

    fn set(&mut self, interface: u32, lit: bool) {
        let (before, changes) = self.0.entry(interface).or_insert((true, 0));
        *changes += u64::from(*before != lit);
        *before = lit;
    }

    /// Returns the number of carrier changes, or `None` if the interface has no carrier.
    fn of(&self, interface: u32) -> Option<u64> {
        let (lit, changes) = self.0.get(&interface).copied().unwrap_or((true, 0));
        lit.then_some(changes)
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/node/network.rs"]
mod tests;
