//! A switch with many interfaces, and links behind each. The `replication` tests use it, and `bench
//! forward` measures on it.
//!
//! ```text
//!            ┌ p0 ──── w0 ┐
//!   switch ──┼ p1 ──── w1 ┼── far       one link or many behind each interface
//!            └ p2 ──── w2 ┘
//! ```
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_dataplane::{PlaneConfig, PlaneRoute, Planes, Wanted};
use gdp_link::link::LinkIds;
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_tests::frames::Frame;
use gdp_tests::netns::{Door, End, Namespace, execute, veth};
use gdp_tests::packet::PacketSocket;
use gdp_tests::programs::{Executable as _, Program};
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::{Carrier, Counter, LinkEntry, LinkRole, Name};
use parking_lot::Mutex;

pub const OWN_BIT: u64 = 1 << 5;

/// The writer's link: the first link, behind the first interface.
pub const WRITER: Leaf = Leaf { index: 1, interface: 0, reach: 0 };

/// The plane of a switch that must forward.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plane {
    Kernel,
    Userspace,
}

/// The peer of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leaf {
    /// Number from 1.
    pub index: u32,
    pub interface: usize,
    /// Egress bits that the link leads to; 0 for an endpoint.
    pub reach: u64,
}

impl Leaf {
    /// Returns the switch's id of the link.
    pub fn id(&self) -> u32 {
        0x1000 + self.index
    }

    pub fn peer_id(&self) -> u32 {
        0x2000 + self.index
    }

    pub fn mac(&self) -> [u8; 6] {
        [2, 0, 0, 1, (self.index >> 8) as u8, self.index as u8]
    }

    pub fn name(&self) -> Name {
        Name::from_bytes([self.index as u8; 32])
    }

    pub fn rx_key(&self) -> [u64; 2] {
        [self.index.into(), 1]
    }

    pub fn tx_key(&self) -> [u64; 2] {
        [self.index.into(), 2]
    }

    pub fn entry(&self, mtu: u32) -> LinkEntry {
        let role = if self.reach == 0 { LinkRole::Endpoint } else { LinkRole::Switch };
        LinkEntry {
            id: self.id(),
            peer_id: self.peer_id(),
            role: role as u32,
            rx_keys: [self.rx_key(); 2],
            tx_keys: [self.tx_key(); 2],
            reach: self.reach,
            peer: self.name(),
            mtu,
            carrier: Carrier::ethernet(self.mac(), port_mac(self.interface)),
            ..LinkEntry::default()
        }
    }
}

/// Returns `count` endpoints without the writer, distributed over the interfaces from the second
/// on.
pub fn readers(count: usize, interfaces: usize) -> Vec<Leaf> {
    let others = interfaces.max(2) - 1;
    (0..count).map(|i| Leaf { index: 2 + i as u32, interface: (1 + i % others) % interfaces, reach: 0 }).collect()
}

/// The network.
pub struct Star {
    pub switch: Namespace,
    pub far: Namespace,
    pub interfaces: usize,
    mtu: u32,
}

impl Star {
    pub fn build(interfaces: usize, mtu: u32) -> Result<Self> {
        let star = Self { switch: Namespace::create("switch")?, far: Namespace::create("far")?, interfaces, mtu };
        for i in 0..interfaces {
            let (here, there) = (port(i), far_port(i));
            veth(
                &End { namespace: &star.far, interface: &there, mac: [2, 0, 0, 2, 0, i as u8] },
                &End { namespace: &star.switch, interface: &here, mac: port_mac(i) },
                mtu,
            )?;
            // The kernel notices a GRO change for the other end only while this end is up.
            star.set_gro(i, "off")?;
            star.set_gro(i, "on")?;
        }
        Ok(star)
    }

    /// Turns GRO on or off. Off: the interface accepts no redirected frames.
    pub fn set_gro(&self, interface: usize, state: &str) -> Result<()> {
        execute(self.far.command(Program::Ethtool)?.args(["-K", &far_port(interface), "gro", state])).map(drop)
    }

    /// From now on a separate thread receives on the first interface, and finds several frames at a
    /// time. Otherwise the writer's own thread does, after each frame.
    pub fn take_in_batches(&self) -> Result<()> {
        let threaded = "echo 1 > /sys/class/net/p0/threaded";
        execute(Program::Ip.command().args(["netns", "exec", self.switch.name(), Program::Sh.name(), "-c", threaded]))
            .map(drop)
    }

    /// Starts a switch on all interfaces with these links.
    pub fn start(&self, config: PlaneConfig, links: &[Leaf]) -> Result<Switch> {
        let _inside = self.switch.enter()?;
        let mut switch = Switch::open(config, self.switch.door()?, self.interfaces)?;
        switch.planes.set_own_bit(OWN_BIT)?;
        links.iter().try_for_each(|leaf| switch.set_link(leaf, self.mtu))?;
        Ok(switch)
    }
}

pub fn xdp(ebpf_object: std::path::PathBuf) -> PlaneConfig {
    PlaneConfig { wanted: Wanted::Xdp, ebpf_object: Some(ebpf_object), ..PlaneConfig::default() }
}

/// The planes of the switch. Interface numbers are valid only in the switch's namespace, so planes
/// are changed there.
pub struct Switch {
    planes: Planes,
    ports: Vec<Port>,
    _runtime: tokio::runtime::Runtime,
    door: Door,
}

impl Switch {
    /// Opens the planes and attaches all interfaces. Call this in the switch's namespace, which
    /// `door` refers to.
    pub fn open(config: PlaneConfig, door: Door, interfaces: usize) -> Result<Self> {
        let mut planes = Planes::open(config)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let entered = runtime.enter();
        let mut ports = Vec::new();
        for i in 0..interfaces {
            let port = Port::ethernet(&port(i), &PortConfig::switch(Identity::generate("switch")?, LinkIds::new()))?;
            let found = port.interface().context("an Ethernet port has an interface")?.clone();
            planes.attach(&found, port.data())?;
            ports.push(port);
        }
        drop(entered);
        Ok(Self { planes, ports, _runtime: runtime, door })
    }

    pub fn planes(&self) -> &Planes {
        &self.planes
    }

    pub fn change<T>(&mut self, change: impl FnOnce(&mut Planes) -> T) -> Result<T> {
        let _inside = self.door.enter()?;
        Ok(change(&mut self.planes))
    }

    pub fn set_link(&mut self, leaf: &Leaf, mtu: u32) -> Result<()> {
        let ifindex = self.ports[leaf.interface].interface().context("an interface")?.index;
        let to = LinkAddr::Ethernet { ifindex, mac: leaf.mac() };
        Ok(self.change(|planes| planes.set_link(leaf.entry(mtu), to))??)
    }

    /// Sets a route for frames from the writer.
    pub fn set_route(&mut self, name: Name, egress_bits: u64, readers: &[Leaf]) -> Result<()> {
        let mut readers: Vec<u32> = readers.iter().map(Leaf::id).collect();
        readers.sort_unstable();
        let route = PlaneRoute { egress_bits, readers, writers: vec![WRITER.id()], ..PlaneRoute::default() };
        Ok(self.change(|planes| planes.set_route(name, &route))??)
    }

    /// Returns the counts of the kernel and of the userspace plane.
    pub fn count(&self, wanted: Counter) -> Result<(u64, u64)> {
        let counted = self.planes.counters()?.into_iter().find(|(counter, ..)| *counter == wanted);
        counted.map(|(_, kernel, userspace)| (kernel, userspace)).context("all counters")
    }

    /// Returns all counters that are not 0, for messages.
    pub fn counted(&self) -> Result<Vec<(&'static str, u64, u64)>> {
        let all = self.planes.counters()?.into_iter().filter(|(_, kernel, userspace)| kernel + userspace > 0);
        Ok(all.map(|(counter, kernel, userspace)| (counter.as_str(), kernel, userspace)).collect())
    }
}

impl Drop for Switch {
    fn drop(&mut self) {
        // The planes detach in their namespace.
        let inside = self.door.enter();
        self.planes.detach_all();
        drop(inside);
    }
}

/// Sends frames to the switch, and stores all data frames that it returns.
pub struct Far {
    writer: PacketSocket,
    inbox: Arc<Inbox>,
    threads: Vec<JoinHandle<()>>,
    /// Frames sent so far, by link.
    sent: HashMap<u32, u64>,
}

#[derive(Default)]
struct Inbox {
    stop: AtomicBool,
    /// Frames by their link id.
    frames: Mutex<HashMap<u32, Vec<Vec<u8>>>>,
}

/// Most frames in flight: less than a veth's ring of 256, with 64 copies each in its one queue.
const WINDOW: u64 = 32;

impl Far {
    pub fn start(star: &Star) -> Result<Self> {
        let inbox = Arc::new(Inbox::default());
        let mut threads = Vec::new();
        for i in 0..star.interfaces {
            let socket = PacketSocket::open(&star.far, &far_port(i))?;
            socket.set_receive_buffer(64 << 20)?;
            let inbox = inbox.clone();
            threads.push(std::thread::spawn(move || inbox.fill_from(&socket)));
        }
        let writer = PacketSocket::open(&star.far, &far_port(WRITER.interface))?;
        Ok(Self { writer, inbox, threads, sent: HashMap::new() })
    }

    /// Returns the next frame of a link, `length` bytes long, with its number on the link as
    /// payload.
    pub fn next_frame(&mut self, from: &Leaf, to: Name, length: usize) -> Frame {
        let count = self.sent.entry(from.id()).or_default();
        *count += 1;
        let mut payload = vec![0x5a; length - 96];
        payload[..8].copy_from_slice(&count.to_be_bytes());
        Frame {
            to_mac: port_mac(from.interface),
            from_mac: from.mac(),
            link_id: from.id(),
            link_counter: *count,
            key: from.rx_key(),
            destination: to.to_bytes(),
            source: from.name().to_bytes(),
            payload,
            ..Frame::default()
        }
    }

    /// Sends a frame on the first interface.
    pub fn send(&self, frame: &Frame) -> Result<()> {
        self.send_bytes(&frame.bytes())
    }

    /// Sends raw bytes on the first interface.
    pub fn send_bytes(&self, frame: &[u8]) -> Result<()> {
        self.writer.send(frame)
    }

    /// Waits until all leaves have received this many frames, less the window.
    pub fn keep_pace(&self, leaves: &[Leaf], frames: u64) -> Result<()> {
        self.wait_for_frames(leaves, frames.saturating_sub(WINDOW))
    }

    pub fn wait_for_frames(&self, leaves: &[Leaf], frames: u64) -> Result<()> {
        let slowest = || leaves.iter().map(|leaf| self.received(leaf)).min().unwrap_or(u64::MAX);
        // Usually the frames have arrived, and this does not wait.
        if slowest() >= frames {
            return Ok(());
        }
        wait_for(&format!("{frames} frames at each of {} links", leaves.len()), TIMEOUT, || {
            Ok((slowest() >= frames).then_some(()))
        })
        .with_context(|| format!("got {:?}", leaves.iter().map(|leaf| self.received(leaf)).collect::<Vec<_>>()))
    }

    pub fn received(&self, leaf: &Leaf) -> u64 {
        self.inbox.lock().get(&leaf.peer_id()).map_or(0, |frames| frames.len() as u64)
    }

    /// Returns the number of frames that have arrived since the last `take`.
    pub fn total(&self) -> usize {
        self.inbox.lock().values().map(Vec::len).sum()
    }

    /// Returns the frames that have arrived since the last call, by link id.
    pub fn take(&self) -> HashMap<u32, Vec<Vec<u8>>> {
        std::mem::take(&mut self.inbox.lock())
    }
}

impl Drop for Far {
    fn drop(&mut self) {
        self.inbox.stop.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

impl Inbox {
    fn lock(&self) -> parking_lot::MutexGuard<'_, HashMap<u32, Vec<Vec<u8>>>> {
        self.frames.lock()
    }

    fn fill_from(&self, socket: &PacketSocket) {
        while !self.stop.load(Ordering::Relaxed) {
            // The socket receives only frames from the switch, not frames sent to it.
            let Ok(frame) = socket.receive(Duration::from_millis(50), gdp_tests::packet::is_gdp_data) else { continue };
            let link = u32::from_be_bytes([frame[22], frame[23], frame[24], frame[25]]);
            self.lock().entry(link).or_default().push(frame);
        }
    }
}

/// Checks that `got` is byte for byte the copy of `sent` for a link.
pub fn check_copy(got: &[u8], sent: &Frame, leaf: &Leaf, egress_bits: u64) -> Result<u64> {
    ensure!(got.len() >= 110, "{} bytes", got.len());
    let link_counter = u32::from_be_bytes([got[26], got[27], got[28], got[29]]).into();
    let expected = Frame {
        to_mac: leaf.mac(),
        from_mac: port_mac(leaf.interface),
        hop_limit: sent.hop_limit - 1,
        egress_bits,
        link_id: leaf.peer_id(),
        link_counter,
        key: leaf.tx_key(),
        ..sent.clone()
    };
    let expected = expected.bytes();
    ensure!(got == expected, "to {leaf:?}:\n     got {:02x?}\nexpected {:02x?}", &got[..110], &expected[..110]);
    Ok(link_counter)
}

fn port(i: usize) -> String {
    format!("p{i}")
}

pub fn far_port(i: usize) -> String {
    format!("w{i}")
}

fn port_mac(i: usize) -> [u8; 6] {
    [2, 0, 0, 3, 0, i as u8]
}
