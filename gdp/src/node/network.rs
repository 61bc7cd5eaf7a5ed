//! Notices that this machine is in another network, or back in its own, from what the kernel says
//! of interfaces, addresses and routes. QUIC would find out after seconds of silence.
//! [`super::supervisor`] asks how an address is reached, and waits until that is otherwise.

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
use tokio::time::{sleep, timeout};

use crate::node::abort_on_drop::AbortOnDrop;
use gdp_link::port::LinkAddr;

/// What is listened to.
const GROUPS: [MulticastGroup; 5] = [
    MulticastGroup::Link,
    MulticastGroup::Ipv4Ifaddr,
    MulticastGroup::Ipv6Ifaddr,
    MulticastGroup::Ipv4Route,
    MulticastGroup::Ipv6Route,
];

/// How long the kernel may take to answer. It does at once, unless somebody reconfigures very much.
const TIMEOUT: Duration = Duration::from_secs(1);

/// When it is asked again if it has not answered, or with an error.
const ASK_AGAIN: Duration = Duration::from_secs(1);

/// Between two questions that news raise: they may come in a stream.
const BETWEEN: Duration = Duration::from_millis(5);

/// How what is sent to an address leaves this machine, as far as the kernel says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NetworkPath {
    By(Exit),
    /// Not at all.
    Nowhere,
    /// It could not be found out. Nothing follows from that: whoever wants to get there has to try.
    Unknown,
}

/// The same address and router may be those of another network, if the carrier was lost meanwhile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exit {
    interface: u32,
    /// How often its carrier came and went.
    carrier: u64,
    source: Option<IpAddr>,
    router: Option<IpAddr>,
}

/// The network of this machine, as the namespace sees it in which the runtime was when it was
/// opened.
pub struct Network {
    handle: Handle,
    carriers: Arc<Mutex<Carriers>>,
    changes: watch::Receiver<()>,
    _tasks: [AbortOnDrop; 2],
}

impl Network {
    /// Begins to listen. To be called within a tokio runtime.
    pub fn open() -> std::io::Result<Self> {
        let (connection, handle, mut messages) = rtnetlink::new_multicast_connection(&GROUPS)?;
        let (told, changes) = watch::channel(());
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

    /// Rises whenever anything changes.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.changes.clone()
    }

    /// How `to` is reached; `through` no other interface than that one.
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

    /// Returns how `to` is reached once that is otherwise than `before`; see [`until_other`].
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

/// Returns what `look` finds once that is something else than `before`. What is not known is
/// nothing else; if it was not known before, what is found first is what it was. `changes`: when it
/// may be otherwise.
pub async fn until_other<F: Future<Output = NetworkPath>>(
    mut changes: watch::Receiver<()>,
    mut before: NetworkPath,
    look: impl Fn() -> F,
) -> NetworkPath {
    loop {
        changes.mark_unchanged();
        let now = look().await;
        let changed = async {
            sleep(BETWEEN).await;
            if changes.changed().await.is_err() {
                std::future::pending().await
            }
        };
        match now {
            NetworkPath::Unknown => _ = timeout(ASK_AGAIN, changed).await,
            now if before == NetworkPath::Unknown || before == now => {
                before = now;
                changed.await;
            }
            now => return now,
        }
    }
}

/// As [`until_other`]; but once there is a way, and another one than the last that there was or
/// none.
pub async fn until_led<F: Future<Output = NetworkPath>>(
    changes: watch::Receiver<()>,
    before: NetworkPath,
    look: impl Fn() -> F,
) {
    let mut way = before;
    loop {
        way = until_other(changes.clone(), way, &look).await;
        if let NetworkPath::By(_) = way {
            return;
        }
    }
}

/// What the kernel says of an address.
#[derive(Debug, PartialEq, Eq)]
enum Answer {
    /// Interface, source and router.
    Route((u32, Option<IpAddr>, Option<IpAddr>)),
    NoRoute,
    /// None in time, or that it cannot say.
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

/// Whether this error says that there is no route, now; others say that something else is wrong.
fn is_no_route(errno: i32) -> bool {
    // The last is of an interface that is gone.
    matches!(errno, libc::ENETUNREACH | libc::EHOSTUNREACH | libc::EACCES | libc::ENODEV)
}

fn ip(address: &RouteAddress) -> Option<IpAddr> {
    match address {
        RouteAddress::Inet(address) => Some((*address).into()),
        RouteAddress::Inet6(address) => Some((*address).into()),
        _ => None,
    }
}

/// Which interfaces have a carrier, and how often that has changed. One that nothing was heard of
/// has it.
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

    /// `None`: it has no carrier.
    fn of(&self, interface: u32) -> Option<u64> {
        let (lit, changes) = self.0.get(&interface).copied().unwrap_or((true, 0));
        lit.then_some(changes)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/network.rs"]
mod tests;
