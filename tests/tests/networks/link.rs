//! Links directly on Ethernet: discovery, QUIC in control frames, and data frames at the same time.
//! Two ports on one veth pair:
//!
//! ```text
//!  [ endpoint  e0 ]────────[ s0  switch ]
//!   02:…:01                   02:…:02
//! ```

use gdp_wire::hop;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use gdp_core::identity::Identity;
use gdp_core::peer::Role;
use gdp_link::link::{IDLE_TIMEOUT, Link, LinkError, LinkIds};
use gdp_link::port::{InFrame, LinkAddr, OutFrame, Port, PortConfig, RecvBatch};
use gdp_tests::netns::{End, Namespace, veth};
use gdp_wire::{Header, forward, replay};
use zerocopy::{FromBytes, IntoBytes};

const SWITCH_MAC: [u8; 6] = [2, 0, 0, 0, 0, 2];

#[tokio::test]
async fn an_endpoint_finds_its_switch_and_exchanges_frames_with_it() -> Result<()> {
    let cable = Cable::new(1500)?;
    let (endpoint, switch) = cable.ports()?;
    let found = endpoint.discover(None, Duration::from_secs(5)).await;
    let [(to, name)] = found[..] else { panic!("{found:?}") };
    assert_eq!(name, cable.switch.name());
    assert!(matches!(to, LinkAddr::Ethernet { mac: SWITCH_MAC, .. }), "{to}");
    let nobody = endpoint.discover(Some(cable.endpoint.name()), Duration::from_millis(300)).await;
    assert!(nobody.is_empty(), "{nobody:?}");

    let (client, server) = link(&endpoint, &switch, to).await?;
    assert_eq!((client.peer().name, client.peer().role), (cable.switch.name(), Role::Switch));
    assert_eq!((server.peer().name, server.peer().role), (cable.endpoint.name(), Role::Endpoint));
    assert_eq!((client.mtu(), server.mtu()), (1500, 1500));
    let (at_client, at_server) = (client.entry(0), server.entry(0));
    assert_eq!(
        (at_client.carrier.local_mac, at_client.carrier.peer_mac),
        (at_server.carrier.peer_mac, at_server.carrier.local_mac)
    );
    assert_eq!(at_client.carrier.peer_mac.as_bytes(), SWITCH_MAC);

    // Payload sizes: frames below Ethernet's minimum, and a frame as large as the MTU allows.
    for payload in [vec![], vec![1; 7], vec![2; 1500 - Header::LEN]] {
        exchange(&endpoint, &client, &switch, &server, &payload, 300);
        exchange(&switch, &server, &endpoint, &client, &payload, 300);
    }
    assert_eq!(switch.data().receive_drops(), 0);
    Ok(())
}

#[tokio::test]
async fn what_is_not_for_this_station_is_not_received() -> Result<()> {
    let cable = Cable::new(1500)?;
    let (endpoint, switch) = cable.ports()?;
    let LinkAddr::Ethernet { ifindex, .. } = cable.switch_addr(&endpoint) else { unreachable!("an Ethernet port") };
    cable.namespaces.1.ip(&["link", "set", "s0", "promisc", "on"])?;
    let frame = |mac| OutFrame { to: LinkAddr::Ethernet { ifindex, mac }, head: &[0x20; 60], body: &[] };
    let control = OutFrame { head: &[0x11; 60], ..frame(SWITCH_MAC) };
    let sent = endpoint.data().send_batch([frame([2, 0, 0, 0, 0, 9]), control, frame(SWITCH_MAC)]);
    assert_eq!(sent.sent, 3);
    let mut batch = RecvBatch::new(1500);
    assert!(switch.data().wait_readable(Duration::from_secs(5))?);
    assert_eq!(switch.data().try_recv_batch(&mut batch)?, 1);
    let InFrame { bytes, from, .. } = batch.frames().next().context("one frame")?;
    assert_eq!(bytes, [0x20; 60]);
    assert!(matches!(from, LinkAddr::Ethernet { mac: [2, 0, 0, 0, 0, 1], .. }), "{from}");
    Ok(())
}

/// The ports stay open. The link is lost to silence and then established again.
#[tokio::test]
async fn a_port_outlives_its_cable() -> Result<()> {
    let cable = Cable::new(1500)?;
    let (endpoint, switch) = cable.ports()?;
    let to = cable.switch_addr(&endpoint);
    let (client, server) = link(&endpoint, &switch, to).await?;
    cable.namespaces.0.ip(&["link", "set", "e0", "down"])?;
    let begin = Instant::now();
    let (at_client, at_server) = tokio::join!(client.closed(), server.closed());
    assert!(begin.elapsed() < 5 * IDLE_TIMEOUT, "{:?}", begin.elapsed());
    assert!(at_client.contains("nothing heard") && at_server.contains("nothing heard"), "{at_client}, {at_server}");

    cable.namespaces.0.ip(&["link", "set", "e0", "up"])?;
    let (client, server) = link(&endpoint, &switch, to).await?;
    exchange(&endpoint, &client, &switch, &server, b"again", 10);
    Ok(())
}

#[tokio::test]
async fn jumbo_frames_pass_and_the_smaller_mtu_counts() -> Result<()> {
    let cable = Cable::new(9000)?;
    let (endpoint, switch) = cable.ports()?;
    let (client, server) = link(&endpoint, &switch, cable.switch_addr(&endpoint)).await?;
    assert_eq!(client.mtu(), 9000);
    exchange(&endpoint, &client, &switch, &server, &vec![3; 9000 - Header::LEN], 20);

    cable.namespaces.0.ip(&["link", "set", "e0", "mtu", "1400"])?;
    let endpoint = cable.port(true)?;
    let (client, server) = link(&endpoint, &switch, cable.switch_addr(&endpoint)).await?;
    assert_eq!((client.mtu(), server.mtu()), (1400, 1400));

    cable.namespaces.0.ip(&["link", "set", "e0", "mtu", "1000"])?;
    let error = cable.port(true).err().context("an MTU that cannot carry QUIC")?.to_string();
    assert!(error.contains("e0") && error.contains("1000"), "{error}");
    Ok(())
}

/// QUIC discovers what the path takes. It asks the kernel's route for the upper bound.
#[tokio::test]
async fn a_link_over_udp_finds_the_mtu_of_its_path() -> Result<()> {
    for (near, far, largest) in [(1500, 1500, 1472), (4000, 4000, 3972), (9000, 9000, 8972), (9000, 1500, 1472)] {
        let cable = Cable::new(near)?;
        let (at, there) = cable.assign_addresses()?;
        there.ip(&["link", "set", "s0", "mtu", &far.to_string()])?;
        let endpoint = {
            let _inside = at.enter()?;
            Port::udp("0.0.0.0:0".parse()?, &PortConfig::endpoint(cable.endpoint.clone()))?
        };
        let switch = {
            let _inside = there.enter()?;
            Port::udp("10.8.0.2:31415".parse()?, &PortConfig::switch(cable.switch.clone(), LinkIds::new()))?
        };
        let (client, server) = link(&endpoint, &switch, LinkAddr::udp("10.8.0.2:31415".parse()?)).await?;
        let (begin, found) = (Instant::now(), largest - 20..=largest);
        while ![client.mtu(), server.mtu()].iter().all(|mtu| found.contains(mtu)) {
            let mtus = (client.mtu(), server.mtu());
            assert!(begin.elapsed() < Duration::from_secs(20), "{near} and {far}: {mtus:?}");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        println!("{near} and {far}: {} after {:?}", client.mtu(), begin.elapsed());
        exchange(&endpoint, &client, &switch, &server, &vec![3; client.mtu() as usize - Header::LEN], 20);
    }
    Ok(())
}

/// The same question twice, since the first one changes the socket.
#[tokio::test]
async fn the_route_of_a_port_leaves_by_the_interface_of_the_port() -> Result<()> {
    let cable = Cable::new(9000)?;
    let (at, there) = cable.assign_addresses()?;
    let end = |namespace, interface, mac| End { namespace, interface, mac };
    veth(&end(at, "e1", [2, 0, 0, 0, 0, 3]), &end(there, "s1", [2, 0, 0, 0, 0, 4]), 1500)?;
    at.ip(&["addr", "add", "10.9.0.1/24", "dev", "e1"])?;
    let to = LinkAddr::udp("10.9.0.2:31415".parse()?);
    for (through, mtu) in [(None, 1472), (Some("e0".to_owned()), 8972)] {
        let port = {
            let _inside = at.enter()?;
            let config = PortConfig { through, ..PortConfig::endpoint(cable.endpoint.clone()) };
            Port::udp("0.0.0.0:0".parse()?, &config)?
        };
        assert_eq!([port.route_mtu(to), port.route_mtu(to)], [mtu, mtu]);
    }
    Ok(())
}

struct Cable {
    namespaces: (Namespace, Namespace),
    endpoint: Identity,
    switch: Identity,
}

impl Cable {
    fn new(mtu: u32) -> Result<Self> {
        let namespaces = (Namespace::create("endpoint")?, Namespace::create("switch")?);
        let end = |namespace, interface, mac| End { namespace, interface, mac };
        veth(&end(&namespaces.0, "e0", [2, 0, 0, 0, 0, 1]), &end(&namespaces.1, "s0", SWITCH_MAC), mtu)?;
        Ok(Self { namespaces, endpoint: Identity::generate("proxy")?, switch: Identity::generate("switch")? })
    }

    fn ports(&self) -> Result<(Port, Port)> {
        Ok((self.port(true)?, self.port(false)?))
    }

    /// Opens a port. A socket stays in the namespace in which it was opened.
    fn port(&self, endpoint: bool) -> Result<Port, anyhow::Error> {
        if endpoint {
            let _inside = self.namespaces.0.enter()?;
            return Ok(Port::ethernet("e0", &PortConfig::endpoint(self.endpoint.clone()))?);
        }
        let _inside = self.namespaces.1.enter()?;
        Ok(Port::ethernet("s0", &PortConfig::switch(self.switch.clone(), LinkIds::new()))?)
    }

    /// Assigns both ends addresses, and returns their namespaces.
    fn assign_addresses(&self) -> Result<&(Namespace, Namespace)> {
        self.namespaces.0.ip(&["addr", "add", "10.8.0.1/24", "dev", "e0"])?;
        self.namespaces.1.ip(&["addr", "add", "10.8.0.2/24", "dev", "s0"])?;
        Ok(&self.namespaces)
    }

    fn switch_addr(&self, endpoint: &Port) -> LinkAddr {
        let ifindex = endpoint.interface().expect("an Ethernet port").index;
        LinkAddr::Ethernet { ifindex, mac: SWITCH_MAC }
    }
}

async fn link(endpoint: &Port, switch: &Port, to: LinkAddr) -> Result<(Link, Link), LinkError> {
    let (client, server) = tokio::join!(endpoint.dial(to, None), switch.accept());
    Ok((client?, server.expect("an open port")?))
}

/// Sends `count` frames in one direction, in one call, and expects all of them, intact and in
/// order.
fn exchange(from: &Port, out: &Link, to: &Port, input: &Link, payload: &[u8], count: u32) {
    let (egress, ingress, window) = (out.entry(0), input.entry(0), replay::empty());
    let headers: Vec<Header> = (0..count)
        .map(|i| {
            let mut header = Header::data(out.peer().name, input.peer().name, payload.len() as u16);
            hop::stamp(&mut header, &egress, i.into());
            header
        })
        .collect();
    let frames = headers.iter().map(|header| OutFrame { to: out.addr(), head: header.as_bytes(), body: payload });
    assert_eq!(from.data().send_batch(frames).sent, count as usize);

    let (mut batch, mut received, deadline) = (RecvBatch::new(9000), 0, Instant::now() + Duration::from_secs(5));
    while received < count {
        assert!(Instant::now() < deadline, "{received} of {count} frames");
        to.data().wait_readable(Duration::from_millis(100)).expect("a socket");
        to.data().try_recv_batch(&mut batch).expect("a socket");
        for InFrame { bytes: frame, .. } in batch.frames() {
            let (header, rest) = Header::read_from_prefix(frame).expect("a header");
            assert_eq!(forward::accept(&header, frame.len(), &ingress, &window), Ok(gdp_wire::FrameType::Data));
            assert_eq!((header.link_counter(), &rest[..payload.len()]), (received, payload));
            received += 1;
        }
    }
}
