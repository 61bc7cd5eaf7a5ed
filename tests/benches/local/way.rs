//! One path from a writer to a reader through a switch on their host.

use gdp_wire::hop;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_dataplane::{PlaneConfig, PlaneRoute, Planes, Wanted, host_pair};
use gdp_link::link::LinkIds;
use gdp_link::port::{BATCH, DataSocket, Interface, LinkAddr, OutFrame, Port, PortConfig, RecvBatch};
use gdp_tests::netns::{End, Namespace, veth};
use gdp_wire::table::{ip_words, mac_words};
use gdp_wire::{Carrier, Counter, Header, LinkEntry, LinkRole, Name};
use serde::Serialize;
use tokio::runtime::Runtime;
use zerocopy::IntoBytes;

/// The path of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    Daemon,
    Packet,
    Pair,
}

const TOPIC: Name = Name::from_bytes([0xd0; 32]);
const WRITER: Name = Name::from_bytes([0xa1; 32]);
const KEY: [u64; 2] = [7, 0x6764_7062_656e_6368];

/// The switch's ids of its links.
const FROM: u32 = 1;
const TO: u32 = 2;

/// Interval between single frames.
const PACE: Duration = Duration::from_micros(500);

/// Frames in flight; a veth's ring has room for four times as many.
const WINDOW: u64 = BATCH as u64;

const PAYLOAD: usize = 1300;

/// Time without arrivals after which the test fails.
const TIMEOUT: Duration = Duration::from_secs(1);

/// The longest datagram or frame that is read.
const LONGEST: usize = 2048;

pub struct Way {
    kind: Kind,
    writer: Arc<DataSocket>,
    reader: Arc<DataSocket>,
    /// Destination of the writer's frames.
    switch: LinkAddr,
    count: u64,
    batch: RecvBatch,
    planes: Planes,
    _ports: Vec<Port>,
    /// Its threads run in the namespace and serve the UDP sockets.
    _runtime: Runtime,
    _host: Namespace,
}

impl Kind {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Daemon => "daemon",
            Self::Packet => "packet",
            Self::Pair => "pair",
        }
    }
}

impl Way {
    pub fn open(kind: Kind, ebpf_object: &Path) -> Result<Self> {
        let host = Namespace::create(kind.as_str())?;
        if kind == Kind::Packet {
            let end = |interface, number| End { namespace: &host, interface, mac: [2, 0, 0, 0, 0, number] };
            veth(&end("e0", 1), &end("l0", 2), 1500)?;
            veth(&end("e1", 3), &end("l1", 4), 1500)?;
        }
        let door = host.door()?;
        let enter = move || std::mem::forget(door.enter().expect("a namespace that is there"));
        let mut builder = tokio::runtime::Builder::new_multi_thread();
        let runtime = builder.worker_threads(2).enable_all().on_thread_start(enter).build()?;
        let _inside = host.enter()?;
        let entered = runtime.enter();
        let wanted = if kind == Kind::Daemon { Wanted::Userspace } else { Wanted::Xdp };
        let config = PlaneConfig { wanted, ebpf_object: Some(ebpf_object.into()), ..Default::default() };
        let (mut planes, mut ports) = (Planes::open(config)?, Vec::new());
        let ends = if kind == Kind::Packet {
            by_packet(&mut planes, &mut ports)
        } else {
            by_udp(kind, &runtime, &mut planes, &mut ports)
        };
        let [from, to] = ends?;
        planes.set_link(link(FROM, from.carrier), from.at)?;
        planes.set_link(link(TO, to.carrier), to.at)?;
        planes.set_own_bit(1)?;
        planes.set_route(
            TOPIC,
            &PlaneRoute { egress_bits: 1, readers: vec![TO], writers: vec![FROM], ..PlaneRoute::default() },
        )?;
        drop(entered);
        Ok(Self {
            kind,
            writer: from.socket,
            reader: to.socket,
            switch: from.switch,
            count: 0,
            batch: RecvBatch::new(LONGEST),
            planes,
            _ports: ports,
            _runtime: runtime,
            _host: host,
        })
    }

    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Returns the latencies of single frames, sorted.
    pub fn latencies(&mut self, duration: Duration) -> Result<Vec<Duration>> {
        let (start, mut found) = (Instant::now(), Vec::new());
        while start.elapsed() < duration {
            let next = Instant::now() + PACE;
            let sent = Instant::now();
            self.send(1);
            self.receive(1)?;
            found.push(sent.elapsed());
            while Instant::now() < next {
                std::thread::yield_now();
            }
        }
        found.sort();
        Ok(found)
    }

    /// Returns frames per second.
    pub fn rate(&mut self, duration: Duration) -> Result<f64> {
        let (start, mut arrived, mut under_way) = (Instant::now(), 0, 0);
        while start.elapsed() < duration {
            let more = WINDOW - under_way;
            self.send(more);
            let received = self.receive(1)?;
            under_way = under_way + more - received;
            arrived += received;
        }
        let elapsed = start.elapsed();
        self.receive(under_way)?;
        Ok(arrived as f64 / elapsed.as_secs_f64())
    }

    /// Fails unless the frames took the path under measurement and no other.
    pub fn check(&self) -> Result<()> {
        for (counter, kernel, userspace) in self.planes.counters()? {
            let (ours, other) = if self.kind == Kind::Daemon { (userspace, kernel) } else { (kernel, userspace) };
            let fine = if counter == Counter::Delivered {
                ours == self.count && other == 0
            } else {
                !counter.is_drop() || ours == 0
            };
            ensure!(
                fine,
                "{}: {} is {kernel} in the kernel, {userspace} in userspace",
                self.kind.as_str(),
                counter.as_str()
            );
        }
        Ok(())
    }

    /// Returns the counters that are not 0: in the kernel, in userspace.
    fn counted(&self) -> Result<Vec<(&'static str, u64, u64)>> {
        let counted = self.planes.counters()?.into_iter().filter(|(_, kernel, userspace)| kernel + userspace > 0);
        Ok(counted.map(|(counter, kernel, userspace)| (counter.as_str(), kernel, userspace)).collect())
    }

    fn send(&mut self, frames: u64) {
        let entry = LinkEntry { peer_id: FROM, ..link(FROM, Carrier::default()) };
        let headers: Vec<Header> = (0..frames)
            .map(|_| {
                self.count += 1;
                let mut header = Header::data(TOPIC, WRITER, PAYLOAD as u16);
                hop::stamp(&mut header, &entry, self.count);
                header
            })
            .collect();
        let body = [0x5a; PAYLOAD];
        let frames = headers.iter().map(|header| OutFrame { to: self.switch, head: header.as_bytes(), body: &body });
        self.writer.send_batch(frames);
    }

    /// Receives at least `least` frames and returns their number.
    fn receive(&mut self, least: u64) -> Result<u64> {
        let mut received = 0;
        while received < least {
            ensure!(self.reader.wait_readable(TIMEOUT)?, "a frame did not arrive: {:?}", self.counted()?);
            received += self.reader.try_recv_batch(&mut self.batch)? as u64;
        }
        Ok(received)
    }
}

/// An endpoint, and its link from the switch's side.
struct Endpoint {
    socket: Arc<DataSocket>,
    /// Destination of the endpoint's frames.
    switch: LinkAddr,
    carrier: Carrier,
    /// Destination of the switch's frames to the endpoint.
    at: LinkAddr,
}

fn by_packet(planes: &mut Planes, ports: &mut Vec<Port>) -> Result<[Endpoint; 2]> {
    let mut open = |outer: &str, inner: &str| -> Result<Endpoint> {
        let inside = Port::ethernet(inner, &PortConfig::switch(Identity::generate("switch")?, LinkIds::new()))?;
        let outside = Port::ethernet(outer, &PortConfig::endpoint(Identity::generate("proxy")?))?;
        planes.attach(inside.interface().context("an Ethernet port")?, inside.data())?;
        let (here, there) = (Interface::find(inner)?, Interface::find(outer)?);
        let endpoint = Endpoint {
            socket: outside.data(),
            switch: LinkAddr::Ethernet { ifindex: there.index, mac: here.mac },
            carrier: Carrier::ethernet(there.mac, here.mac),
            at: LinkAddr::Ethernet { ifindex: here.index, mac: there.mac },
        };
        ports.extend([inside, outside]);
        Ok(endpoint)
    };
    Ok([open("e0", "l0")?, open("e1", "l1")?])
}

fn by_udp(kind: Kind, runtime: &Runtime, planes: &mut Planes, ports: &mut Vec<Port>) -> Result<[Endpoint; 2]> {
    let any: SocketAddr = "0.0.0.0:0".parse()?;
    let identity = Identity::generate("switch")?;
    let name = identity.name();
    let switch = Port::udp(any, &PortConfig::switch(identity, LinkIds::new()))?;
    let bound = switch.udp_addr().context("a UDP port")?;
    let pair = match kind {
        Kind::Pair => Some(runtime.block_on(runtime.spawn(async move { host_pair::open(&name).await }))??),
        _ => None,
    };
    let addresses = pair.as_ref().map(|pair| pair.addresses);
    planes.attach_udp(switch.data(), bound, pair)?;
    ensure!(planes.host_pair() == addresses, "the pair is not in use");
    ports.push(switch);
    let mut open = || -> Result<Endpoint> {
        let port = Port::udp(any, &PortConfig::endpoint(Identity::generate("proxy")?))?;
        let number = port.udp_addr().context("a UDP port")?.port();
        let localhost = std::net::Ipv4Addr::LOCALHOST;
        let (here, there) = addresses.map_or((localhost, localhost), |pair| (pair.switch_ip, pair.host_ip));
        let macs = addresses.map_or(([0; 6], [0; 6]), |pair| (pair.host_mac, pair.switch_mac));
        let endpoint = Endpoint {
            socket: port.data(),
            switch: LinkAddr::udp((here, bound.port()).into()),
            carrier: Carrier {
                kind: Carrier::UDP4,
                peer_mac: mac_words(macs.0),
                local_mac: mac_words(macs.1),
                peer_port: number.to_be(),
                local_port: bound.port().to_be(),
                peer_ip: ip_words(there.into()).1,
                local_ip: ip_words(here.into()).1,
                ..Carrier::default()
            },
            at: LinkAddr::udp((there, number).into()),
        };
        ports.push(port);
        Ok(endpoint)
    };
    Ok([open()?, open()?])
}

fn link(id: u32, carrier: Carrier) -> LinkEntry {
    LinkEntry {
        id,
        peer_id: id,
        role: LinkRole::Endpoint as u32,
        rx_keys: [KEY; 2],
        tx_keys: [KEY; 2],
        peer: WRITER,
        mtu: 1500,
        carrier,
        ..LinkEntry::default()
    }
}
