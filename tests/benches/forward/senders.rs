//! The cost of a frame for a program that sends on a socket, up to the first XDP hop and through
//! it. Also measures alternative ways to pass frames to the kernel.
//!
//! XDP cannot use a socket's packet directly. A veth copies each into a page before running the
//! program, because sockets allocate packets where XDP may not write (`skb_head_is_locked` in the
//! kernel's `veth_convert_skb_to_xdp_buff`). Each kind of socket sends to three destinations. The
//! first is an interface without a program, whose stack drops the frame at once. The second is an
//! interface with a program that drops it; the third is a switch. The second minus the first is the
//! cost of the conversion, less the cost of the stack. A TAP device whose other end is the switch's
//! avoids the conversion. Written frames go directly into such a page, and XDP sees them before
//! there is a socket-style packet.
//!
//! Endpoints use `AF_PACKET` (`sendmmsg`) and `UDP` (runs of frames as one piece); the others are
//! the rejected alternatives.

use gdp_wire::hop;
use std::fs::File;
use std::io::{IoSlice, Write};
use std::net::UdpSocket;
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_core::identity::Identity;
use gdp_link::port::{BATCH, Interface, LinkAddr, OutFrame, Port, PortConfig};
use gdp_tests::measure::figure::{Figure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_tests::packet::ETHERNET;
use gdp_tests::wait::wait_for;
use gdp_wire::{Header, LinkEntry};
use zerocopy::{FromBytes, IntoBytes};

use crate::Bench;
use crate::path::{Kind, Path};
use crate::rings::{PacketRing, Ring, XdpSocket};
use crate::switch::{self, know_neighbour};
use crate::traffic::Sink;

/// Payload bytes: of small frames, and of frames that leave room for UDP in a packet of 1500 B.
const SMALL: usize = 64;
const LARGE: usize = 1290;

/// Longest time until sent frames arrive.
const TIMEOUT: Duration = Duration::from_millis(200);

/// The name of the TAP device.
const TAP: &str = "tap0";

const STACK: &str = "to a stack that drops";
const SINK: &str = "to XDP that drops";
const SWITCH: &str = "through an XDP switch";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let all = [
        (Medium::Ethernet, STACK),
        (Medium::Ethernet, SINK),
        (Medium::Ethernet, SWITCH),
        (Medium::PacketRing, SWITCH),
        (Medium::Xdp, SWITCH),
        (Medium::Udp, STACK),
        (Medium::Udp, SINK),
        (Medium::Udp, SWITCH),
        (Medium::SingleUdp, STACK),
        (Medium::SingleUdp, SINK),
        (Medium::SingleUdp, SWITCH),
        (Medium::Tap, SINK),
        (Medium::Tap, SWITCH),
    ];
    let title =
        |payload| format!("A frame of {} B from a socket: all that its sender's core does for it", FRAMES + payload);
    let small = figure("senders", title(SMALL), &all, SMALL, bench)?;
    let through: Vec<_> = all.into_iter().filter(|(_, case)| *case == SWITCH).collect();
    Ok(vec![small, figure("senders-large", title(LARGE), &through, LARGE, bench)?])
}

/// Bytes of a packet on Ethernet without the payload.
const FRAMES: usize = ETHERNET + Header::LEN;

fn figure(
    name: &'static str,
    title: String,
    compared: &[(Medium, &'static str)],
    payload: usize,
    bench: &Bench,
) -> Result<Figure> {
    let open = |&(medium, case): &(Medium, &'static str)| -> Result<_> {
        let mut path = match (case, medium) {
            (SWITCH, Medium::Udp | Medium::SingleUdp) => {
                Path::crossing([switch::Medium::Udp4, switch::Medium::Ethernet], bench)?
            }
            (SWITCH, _) => Path::build(Kind::Xdp, 1, bench)?,
            _ => Path::build(Kind::Cable, 0, bench)?,
        };
        let sender = Sender::open(&path, medium, payload)?;
        // If the stack must drop the frames, no program is attached.
        let sink = match (case, medium) {
            (STACK, _) => None,
            (SINK, Medium::Tap) => Some(Sink::attach(path.first_hop(), TAP, bench)?),
            _ => Some(Sink::attach(path.chain().cloud(), "l0", bench)?),
        };
        if (case, medium) == (SWITCH, Medium::Tap) {
            path.attach_to_first_switch(TAP)?;
        }
        Ok((medium, case, sender, sink, path))
    };
    let mut senders = compared.iter().map(open).collect::<Result<Vec<_>>>()?;
    let contenders = senders.iter_mut().map(|(medium, case, sender, sink, _)| {
        Contender::new(medium.as_str(), *case, || sender.send_for(bench.duration(), sink.as_ref()))
    });
    let measures = alternate(bench.rounds, contenders.collect())?;
    senders.iter().try_for_each(|(.., path)| path.check(None))?;
    let figure = Figure::new(name, title, Unit::Nanoseconds, measures);
    let against =
        [(Medium::PacketRing, Medium::Ethernet), (Medium::Xdp, Medium::Ethernet), (Medium::Tap, Medium::Ethernet)];
    let against = against.into_iter().chain([(Medium::Udp, Medium::SingleUdp), (Medium::Udp, Medium::Ethernet)]);
    Ok(against.fold(figure, |figure, (one, over)| figure.compare(one.as_str(), over.as_str(), |_| None)))
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Medium {
    /// Like endpoints on Ethernet: `sendmmsg`.
    Ethernet,
    PacketRing,
    Xdp,
    /// Like endpoints over UDP: runs of frames.
    Udp,
    /// `sendmmsg` with one frame per message.
    SingleUdp,
    Tap,
}

impl Medium {
    fn as_str(self) -> &'static str {
        match self {
            Self::Ethernet => "AF_PACKET",
            Self::PacketRing => "AF_PACKET, ring",
            Self::Xdp => "AF_XDP",
            Self::Udp => "UDP",
            Self::SingleUdp => "UDP, frame by frame",
            Self::Tap => "TAP",
        }
    }
}

/// The exit of a sender's frames.
enum Exit {
    Socket(Box<Port>, LinkAddr),
    Single(UdpSocket),
    /// A ring, and the frames' Ethernet header.
    Ring(Box<dyn Ring>, [u8; ETHERNET]),
    Tap(File, [u8; ETHERNET]),
}

/// An endpoint at the robot that counts, tags and sends like `gdp` endpoints.
struct Sender {
    exit: Exit,
    link: LinkEntry,
    count: u64,
    headers: [Header; BATCH],
    payload: Vec<u8>,
    _runtime: tokio::runtime::Runtime,
}

impl Sender {
    fn open(path: &Path, medium: Medium, payload: usize) -> Result<Self> {
        let robot = path.chain().robot();
        let frames = path.frames(path.around() + Header::LEN + payload);
        let header = Header::read_from_prefix(&frames.frame[frames.header_at..]);
        let (header, _) = header.ok().context("a frame has a header")?;
        if matches!(medium, Medium::Udp | Medium::SingleUdp) {
            robot.ip(&["addr", "add", "10.9.0.1/24", "dev", "r0"])?;
            // No interface has this address: a stack drops frames to it immediately. The switch
            // ignores it.
            know_neighbour(robot, "r0", switch::link_ip(switch::Medium::Udp4, 0, 2), [2, 0, 0, 0, 0xff, 0xff])?;
        }
        let _inside = if medium == Medium::Tap { path.first_hop().enter()? } else { robot.enter()? };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let within = runtime.enter();
        let config = PortConfig::endpoint(Identity::generate("endpoint")?);
        let ethernet = frames.frame[..ETHERNET].try_into()?;
        let exit = match medium {
            Medium::Ethernet => {
                let to =
                    LinkAddr::Ethernet { ifindex: Interface::find("r0")?.index, mac: frames.frame[..6].try_into()? };
                Exit::Socket(Box::new(Port::ethernet("r0", &config)?), to)
            }
            Medium::PacketRing => Exit::Ring(Box::new(PacketRing::open(Interface::find("r0")?.index)?), ethernet),
            Medium::Xdp => Exit::Ring(Box::new(XdpSocket::open(Interface::find("r0")?.index)?), ethernet),
            Medium::Udp => {
                let [from, to] = [1, 2].map(|end| switch::link_socket(switch::Medium::Udp4, 0, end));
                Exit::Socket(Box::new(Port::udp(from, &config)?), LinkAddr::Udp(to))
            }
            Medium::SingleUdp => {
                let [from, to] = [1, 2].map(|end| switch::link_socket(switch::Medium::Udp4, 0, end));
                let socket = UdpSocket::bind(from)?;
                socket.connect(to)?;
                Exit::Single(socket)
            }
            Medium::Tap => {
                let device = tap(TAP)?;
                path.first_hop().ip(&["link", "set", TAP, "up"])?;
                Exit::Tap(device, ethernet)
            }
        };
        drop(within);
        let (headers, payload) = ([header; BATCH], vec![0x5a; payload]);
        Ok(Self { exit, link: frames.link, count: 0, headers, payload, _runtime: runtime })
    }

    /// Returns nanoseconds per frame. A veth's other end runs on the sender's core, within the
    /// sending system call.
    fn send_for(&mut self, duration: Duration, sink: Option<&Sink>) -> Result<Sample> {
        let arrived = || sink.map_or(Ok(0), Sink::arrived);
        let before = arrived()?;
        let (start, mut sent) = (Instant::now(), 0);
        while start.elapsed() < duration {
            for header in &mut self.headers {
                self.count += 1;
                hop::stamp(header, &self.link, self.count);
            }
            self.send_batch()?;
            sent += BATCH as u64;
        }
        let value = start.elapsed().as_nanos() as f64 / sent as f64;
        if sink.is_some() {
            let all = || -> Result<_> { Ok((arrived()? - before >= sent).then_some(())) };
            wait_for("the frames that were sent", TIMEOUT, all)?;
        }
        Ok(Sample { value, ..Sample::default() })
    }

    /// Sends one frame per header.
    fn send_batch(&mut self) -> Result<()> {
        match &mut self.exit {
            Exit::Socket(port, to) => {
                let frames = self.headers.iter();
                let frames = frames.map(|header| OutFrame { to: *to, head: header.as_bytes(), body: &self.payload });
                let batch = port.data().send_batch(frames);
                ensure!(batch.lost == 0, "the kernel took {} of {BATCH} frames", batch.sent);
            }
            Exit::Single(socket) => send_single(socket, &self.headers, &self.payload)?,
            Exit::Ring(ring, ethernet) => {
                for header in &self.headers {
                    ring.put([ethernet, header.as_bytes(), &self.payload])?;
                }
                ring.send()?;
            }
            Exit::Tap(device, ethernet) => {
                for header in &self.headers {
                    let pieces = [&ethernet[..], header.as_bytes(), &self.payload].map(IoSlice::new);
                    let written = device.write_vectored(&pieces)?;
                    ensure!(
                        written == ETHERNET + Header::LEN + self.payload.len(),
                        "the kernel took {written} bytes of a frame"
                    );
                }
            }
        }
        Ok(())
    }
}

fn send_single(socket: &UdpSocket, headers: &[Header; BATCH], payload: &[u8]) -> Result<()> {
    // SAFETY: plain structures of integers and pointers, for which zero is a valid value.
    let mut messages: [libc::mmsghdr; BATCH] = unsafe { std::mem::zeroed() };
    let mut pieces = headers.each_ref().map(|header| [header.as_bytes(), payload].map(IoSlice::new));
    for (message, pieces) in messages.iter_mut().zip(&mut pieces) {
        // An `IoSlice` is an `iovec`.
        message.msg_hdr.msg_iov = pieces.as_mut_ptr().cast();
        message.msg_hdr.msg_iovlen = pieces.len();
    }
    // SAFETY: the messages point to pieces that outlive the call, and the kernel only reads them.
    let sent = unsafe { libc::sendmmsg(socket.as_raw_fd(), messages.as_mut_ptr(), BATCH as u32, 0) };
    ensure!(sent == BATCH as i32, "the kernel took {sent} of {BATCH} frames");
    Ok(())
}

/// Creates a TAP device in the calling thread's network namespace. Closing the file deletes it.
fn tap(name: &str) -> Result<File> {
    let device = File::options().read(true).write(true).open("/dev/net/tun").context("cannot open /dev/net/tun")?;
    // SAFETY: zero is a valid value of every variant.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    for (to, from) in request.ifr_name.iter_mut().zip(name.bytes()) {
        *to = from as libc::c_char;
    }
    request.ifr_ifru.ifru_flags = (libc::IFF_TAP | libc::IFF_NO_PI) as i16;
    // SAFETY: the request reads an `ifreq`.
    let result = unsafe { libc::ioctl(device.as_raw_fd(), libc::TUNSETIFF, &raw const request) };
    ensure!(result == 0, "cannot make {name}: {}", std::io::Error::last_os_error());
    Ok(device)
}
