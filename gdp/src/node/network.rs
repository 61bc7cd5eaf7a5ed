//! Notices that this machine is in another network, or back in its own, from what the kernel says of interfaces, addresses and routes.
//! QUIC would find out after seconds of silence. [`super::supervisor`] asks how an address is reached, and waits until that is otherwise.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex};

use futures::{StreamExt, TryStreamExt};
use netlink_packet_core::NetlinkPayload;
use netlink_packet_route::RouteNetlinkMessage;
use netlink_packet_route::link::{LinkFlags, LinkMessage};
use netlink_packet_route::route::{RouteAddress, RouteAttribute, RouteMessage};
use rtnetlink::{Handle, MulticastGroup, RouteMessageBuilder};
use tokio::sync::watch;

use super::state::lock;
use super::supervisor::AbortOnDrop;
use crate::port::LinkAddr;

/// What is listened to.
const GROUPS: [MulticastGroup; 5] = [
    MulticastGroup::Link,
    MulticastGroup::Ipv4Ifaddr,
    MulticastGroup::Ipv6Ifaddr,
    MulticastGroup::Ipv4Route,
    MulticastGroup::Ipv6Route,
];

/// How what is sent to an address leaves this machine. The same address and router may be those of another network, if the carrier was
/// lost meanwhile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Way {
    interface: u32,
    /// How often its carrier came and went.
    carrier: u64,
    source: Option<IpAddr>,
    router: Option<IpAddr>,
}

/// The network of this machine, as the namespace sees it in which the runtime was when it was opened.
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
                    NetlinkPayload::InnerMessage(RouteNetlinkMessage::NewLink(link)) => lock(&kept).take(&link),
                    NetlinkPayload::InnerMessage(RouteNetlinkMessage::DelLink(link)) => lock(&kept).gone(&link),
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

    /// How `to` is reached, if it is; `through` no other interface than that one.
    pub async fn way(&self, to: LinkAddr, through: Option<u32>) -> Option<Way> {
        let (interface, source, router) = match to {
            LinkAddr::Ethernet { ifindex, .. } => (ifindex, None, None),
            LinkAddr::Udp(to) => {
                let route = self.route(to.ip().to_canonical(), through).await?;
                let (mut interface, mut source, mut router) = (None, None, None);
                for attribute in &route.attributes {
                    match attribute {
                        RouteAttribute::Oif(index) => interface = Some(*index),
                        RouteAttribute::PrefSource(address) => source = ip(address),
                        RouteAttribute::Gateway(address) => router = ip(address),
                        _ => {}
                    }
                }
                (interface?, source, router)
            }
        };
        let carrier = lock(&self.carriers).of(interface)?;
        Some(Way { interface, carrier, source, router })
    }

    /// Returns how `to` is reached once that is otherwise than `before`.
    pub async fn until_other(&self, to: LinkAddr, through: Option<u32>, before: &Option<Way>) -> Option<Way> {
        let mut changes = self.changes();
        loop {
            changes.mark_unchanged();
            let now = self.way(to, through).await;
            if now != *before {
                return now;
            }
            if changes.changed().await.is_err() {
                return std::future::pending().await;
            }
        }
    }

    async fn route(&self, to: IpAddr, through: Option<u32>) -> Option<RouteMessage> {
        let bits = if to.is_ipv4() { 32 } else { 128 };
        let mut asked = RouteMessageBuilder::<IpAddr>::new().destination_prefix(to, bits).ok()?;
        if let Some(interface) = through {
            asked = asked.output_interface(interface);
        }
        // An error says that there is none.
        self.handle.route().get(asked.build()).execute().try_next().await.ok().flatten()
    }
}

fn ip(address: &RouteAddress) -> Option<IpAddr> {
    match address {
        RouteAddress::Inet(address) => Some((*address).into()),
        RouteAddress::Inet6(address) => Some((*address).into()),
        _ => None,
    }
}

/// Which interfaces have a carrier, and how often that has changed. One that nothing was heard of has it.
#[derive(Debug, Default)]
struct Carriers(HashMap<u32, (bool, u64)>);

impl Carriers {
    fn take(&mut self, link: &LinkMessage) {
        self.set(link.header.index, link.header.flags.contains(LinkFlags::Up | LinkFlags::LowerUp));
    }

    fn gone(&mut self, link: &LinkMessage) {
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
mod tests {
    use super::*;

    #[test]
    fn an_interface_whose_carrier_was_lost_meanwhile_is_another() {
        let mut carriers = Carriers::default();
        let first = carriers.of(7);
        assert!(first.is_some(), "nothing was heard of it");
        carriers.set(7, true);
        assert_eq!(carriers.of(7), first, "a message about something else");
        carriers.set(7, false);
        assert_eq!(carriers.of(7), None);
        assert_eq!(carriers.of(8), first, "another one");
        carriers.set(7, true);
        assert!(carriers.of(7).is_some_and(|again| Some(again) != first));
    }

    #[tokio::test]
    async fn an_address_on_this_machine_is_reached_and_nothing_changes_by_itself() {
        let network = Network::open().unwrap();
        let to = LinkAddr::udp("127.0.0.1:9".parse().unwrap());
        let way = network.way(to, None).await;
        assert!(way.as_ref().is_some_and(|way| way.source == Some("127.0.0.1".parse().unwrap())), "{way:?}");
        assert_eq!(network.way(to, None).await, way);
        assert_eq!(network.until_other(to, None, &None).await, way, "at once, as it is another");
    }
}
