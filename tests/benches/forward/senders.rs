//! What a frame costs a program that sends by a socket, up to the first XDP hop and through it.
//!
//! A socket's packet is not what XDP works on: a veth copies each into a page of its own before it runs the program, because
//! sockets allocate packets where XDP may not have them (`skb_head_is_locked` in the kernel's `veth_convert_skb_to_xdp_buff`).
//! Here each kind of socket sends to an interface without a program, whose stack drops the frame at once; to one with a program
//! that drops it; and through a switch. What the second takes more than the first is the conversion, less what the stack
//! would have taken. The way around the conversion is a TAP device whose other end is the switch's: what a program writes to it
//! goes into such a page at once, and XDP sees it before there is a packet of the kind that sockets make.

use std::fs::File;
use std::io::{IoSlice, Write};
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp::identity::Identity;
use gdp::port::{BATCH, Interface, LinkAddr, OutFrame, Port, PortConfig};
use gdp_tests::measure::figure::{Figure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_tests::packet::ETHERNET;
use gdp_tests::wait::wait_for;
use gdp_wire::{Header, LinkEntry, forward};
use zerocopy::{FromBytes, IntoBytes};

use crate::Bench;
use crate::path::{Kind, Path};
use crate::switch::{self, know_neighbour};
use crate::traffic::Sink;

const PAYLOAD: usize = 64;

/// How long what was sent may take to arrive.
const PATIENCE: Duration = Duration::from_millis(200);

/// The name of the TAP device.
const TAP: &str = "tap0";

const STACK: &str = "to a stack that drops";
const SINK: &str = "to XDP that drops";
const SWITCH: &str = "through an XDP switch";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let (packet, udp, tap) = ("AF_PACKET", "UDP", "TAP");
    let open = |series, case, medium| -> Result<_> {
        let mut path = match (case, medium) {
            (SWITCH, Medium::Udp) => Path::crossing([switch::Medium::Udp4, switch::Medium::Ethernet], bench)?,
            (SWITCH, _) => Path::build(Kind::Xdp, 1, bench)?,
            _ => Path::build(Kind::Cable, 0, bench)?,
        };
        let sender = Sender::open(&path, medium)?;
        // Where the stack is to drop, there must be no program.
        let sink = match (case, medium) {
            (STACK, _) => None,
            (SINK, Medium::Tap) => Some(Sink::attach(path.first_hop(), TAP, bench)?),
            _ => Some(Sink::attach(path.chain().cloud(), "l0", bench)?),
        };
        if (case, medium) == (SWITCH, Medium::Tap) {
            path.attach_to_first_switch(TAP)?;
        }
        Ok((series, case, sender, sink, path))
    };
    let mut senders = [
        open(packet, STACK, Medium::Ethernet)?,
        open(packet, SINK, Medium::Ethernet)?,
        open(packet, SWITCH, Medium::Ethernet)?,
        open(udp, STACK, Medium::Udp)?,
        open(udp, SINK, Medium::Udp)?,
        open(udp, SWITCH, Medium::Udp)?,
        open(tap, SINK, Medium::Tap)?,
        open(tap, SWITCH, Medium::Tap)?,
    ];
    let contenders = senders.iter_mut().map(|(series, case, sender, sink, _)| {
        Contender::new(series, *case, || sender.send_for(bench.duration(), sink.as_ref()))
    });
    let measures = alternate(bench.rounds, contenders.collect())?;
    senders.iter().try_for_each(|(.., path)| path.check(None))?;
    let title = "A frame of 174 B from a socket: all that its sender's core does for it";
    let figure = Figure::new("senders", title, Unit::Nanoseconds, measures);
    Ok(vec![figure.compare(tap, packet, |_| None)])
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Medium {
    Ethernet,
    Udp,
    Tap,
}

/// Where a sender's frames leave.
enum Exit {
    Socket(Box<Port>, LinkAddr),
    /// With the Ethernet header that the frames get.
    Tap(File, [u8; ETHERNET]),
}

/// An endpoint at the robot, which counts, tags and sends as the endpoints of `gdp` do.
struct Sender {
    exit: Exit,
    link: LinkEntry,
    count: u64,
    headers: [Header; BATCH],
    payload: [u8; PAYLOAD],
    _runtime: tokio::runtime::Runtime,
}

impl Sender {
    fn open(path: &Path, medium: Medium) -> Result<Self> {
        let robot = path.chain().robot();
        let frames = path.frames(path.around() + Header::LEN + PAYLOAD);
        let header = Header::read_from_prefix(&frames.frame[frames.header_at..]);
        let (header, _) = header.ok().context("a frame has a header")?;
        if medium == Medium::Udp {
            robot.ip(&["addr", "add", "10.9.0.1/24", "dev", "r0"])?;
            // No interface has this address: a stack drops what is sent there at its first look. The switch does not look.
            know_neighbour(robot, "r0", switch::link_ip(switch::Medium::Udp4, 0, 2), [2, 0, 0, 0, 0xff, 0xff])?;
        }
        let _inside = if medium == Medium::Tap { path.first_hop().enter()? } else { robot.enter()? };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let within = runtime.enter();
        let config = PortConfig::endpoint(Identity::generate("endpoint")?);
        let exit = match medium {
            Medium::Ethernet => {
                let to =
                    LinkAddr::Ethernet { ifindex: Interface::find("r0")?.index, mac: frames.frame[..6].try_into()? };
                Exit::Socket(Box::new(Port::ethernet("r0", &config)?), to)
            }
            Medium::Udp => {
                let [from, to] = [1, 2].map(|end| switch::link_socket(switch::Medium::Udp4, 0, end));
                Exit::Socket(Box::new(Port::udp(from, &config)?), LinkAddr::Udp(to))
            }
            Medium::Tap => {
                let device = tap(TAP)?;
                path.first_hop().ip(&["link", "set", TAP, "up"])?;
                Exit::Tap(device, frames.frame[..ETHERNET].try_into()?)
            }
        };
        drop(within);
        let (headers, payload) = ([header; BATCH], [0x5a; PAYLOAD]);
        Ok(Self { exit, link: frames.link, count: 0, headers, payload, _runtime: runtime })
    }

    /// Nanoseconds a frame. A veth's other end works on the sender's core, within the system call that sends.
    fn send_for(&mut self, duration: Duration, sink: Option<&Sink>) -> Result<Sample> {
        let arrived = || sink.map_or(Ok(0), Sink::arrived);
        let before = arrived()?;
        let (start, mut sent) = (Instant::now(), 0);
        while start.elapsed() < duration {
            for header in &mut self.headers {
                self.count += 1;
                forward::stamp(header, &self.link, self.count);
            }
            self.send_batch()?;
            sent += BATCH as u64;
        }
        let value = start.elapsed().as_nanos() as f64 / sent as f64;
        if sink.is_some() {
            let all = || -> Result<_> { Ok((arrived()? - before >= sent).then_some(())) };
            wait_for("the frames that were sent", PATIENCE, all)?;
        }
        Ok(Sample { value, ..Sample::default() })
    }

    /// One frame for each of the headers.
    fn send_batch(&mut self) -> Result<()> {
        match &mut self.exit {
            Exit::Socket(port, to) => {
                let frames = self.headers.iter();
                let frames = frames.map(|header| OutFrame { to: *to, head: header.as_bytes(), body: &self.payload });
                let batch = port.data().send_batch(frames);
                ensure!(batch.lost == 0, "the kernel took {} of {BATCH} frames", batch.sent);
            }
            Exit::Tap(device, ethernet) => {
                for header in &self.headers {
                    let pieces = [&ethernet[..], header.as_bytes(), &self.payload].map(IoSlice::new);
                    let written = device.write_vectored(&pieces)?;
                    ensure!(written == ETHERNET + Header::LEN + PAYLOAD, "the kernel took {written} bytes of a frame");
                }
            }
        }
        Ok(())
    }
}

/// A TAP device of the calling thread's network namespace. It goes when the file is closed.
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
