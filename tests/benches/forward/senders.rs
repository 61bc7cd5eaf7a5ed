//! What a frame costs a program that sends by a socket, up to the first XDP hop and through it.
//!
//! A socket's packet is not what XDP works on: a veth copies each into a page of its own before it runs the program, because
//! sockets allocate packets where XDP may not have them (`skb_head_is_locked` in the kernel's `veth_convert_skb_to_xdp_buff`).
//! Here each kind of socket sends to an interface without a program, whose stack drops the frame at once; to one with a program
//! that drops it; and through a switch. What the second takes more than the first is the conversion, less what the stack
//! would have taken.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp::identity::Identity;
use gdp::port::{BATCH, Interface, LinkAddr, OutFrame, Port, PortConfig};
use gdp_tests::wait::wait_for;
use gdp_wire::{Header, LinkEntry, forward};
use zerocopy::{FromBytes, IntoBytes};

use crate::Bench;
use crate::figure::{Figure, Unit};
use crate::path::{Kind, Path};
use crate::rounds::{Contender, Sample, alternate};
use crate::traffic::Traffic;

const PAYLOAD: usize = 64;

/// How long what was sent may take to arrive.
const PATIENCE: Duration = Duration::from_millis(200);

const STACK: &str = "to a stack that drops";
const SINK: &str = "to XDP that drops";
const SWITCH: &str = "through an XDP switch";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let (packet, udp) = ("AF_PACKET", "UDP");
    let open = |series, case, kind, hops, medium| -> Result<_> {
        let path = Path::build(kind, hops, bench)?;
        let sender = Sender::open(&path, medium)?;
        // Where the stack is to drop, there must be no program.
        let sink = (case != STACK).then(|| Traffic::new(path.chain(), path.frames(PAYLOAD), &bench.bench_object));
        Ok((series, case, sender, sink.transpose()?, path))
    };
    let mut senders = [
        open(packet, STACK, Kind::Cable, 0, Medium::Ethernet)?,
        open(packet, SINK, Kind::Cable, 0, Medium::Ethernet)?,
        open(packet, SWITCH, Kind::Xdp, 1, Medium::Ethernet)?,
        open(udp, STACK, Kind::Cable, 0, Medium::Udp)?,
        open(udp, SINK, Kind::Cable, 0, Medium::Udp)?,
    ];
    let contenders = senders.iter_mut().map(|(series, case, sender, sink, _)| {
        Contender::new(series, *case, || sender.send_for(bench.duration(), sink.as_ref()))
    });
    let measures = alternate(bench.rounds, contenders.collect())?;
    senders.iter().try_for_each(|(.., path)| path.check(None))?;
    let title = "A frame of 174 B from a socket: all that its sender's core does for it";
    Ok(vec![Figure::new("senders", title, Unit::Nanoseconds, measures)])
}

#[derive(Clone, Copy)]
enum Medium {
    Ethernet,
    Udp,
}

/// An endpoint at the robot, which counts, tags and sends as the endpoints of `gdp` do.
struct Sender {
    port: Port,
    to: LinkAddr,
    link: LinkEntry,
    count: u64,
    headers: [Header; BATCH],
    payload: [u8; PAYLOAD],
    _runtime: tokio::runtime::Runtime,
}

impl Sender {
    fn open(path: &Path, medium: Medium) -> Result<Self> {
        let robot = path.chain().robot();
        let frames = path.frames(PAYLOAD);
        let header = Header::read_from_prefix(&frames.frame[frames.header_at..]);
        let (header, _) = header.ok().context("a frame has a header")?;
        let mac = frames.frame[..6].try_into()?;
        if let Medium::Udp = medium {
            robot.ip(&["addr", "add", "10.9.0.1/24", "dev", "r0"])?;
            // Nobody's address: a stack drops what is sent there at its first look.
            robot.ip(&[
                "neigh",
                "replace",
                "10.9.0.2",
                "lladdr",
                "02:00:00:00:ff:ff",
                "dev",
                "r0",
                "nud",
                "permanent",
            ])?;
        }
        let _inside = robot.enter()?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let within = runtime.enter();
        let config = PortConfig::endpoint(Identity::generate("endpoint")?);
        let (port, to) = match medium {
            Medium::Ethernet => {
                let ifindex = Interface::find("r0")?.index;
                (Port::ethernet("r0", &config)?, LinkAddr::Ethernet { ifindex, mac })
            }
            Medium::Udp => {
                let udp = |address: [u8; 4]| SocketAddr::from((address, gdp_wire::UDP_PORT));
                (Port::udp(udp([10, 9, 0, 1]), &config)?, LinkAddr::Udp(udp([10, 9, 0, 2])))
            }
        };
        drop(within);
        let (headers, payload) = ([header; BATCH], [0x5a; PAYLOAD]);
        Ok(Self { port, to, link: frames.link, count: 0, headers, payload, _runtime: runtime })
    }

    /// Nanoseconds a frame. A veth's other end works on the sender's core, within the system call that sends.
    fn send_for(&mut self, duration: Duration, sink: Option<&Traffic>) -> Result<Sample> {
        let arrived = || sink.map_or(Ok(0), Traffic::arrived);
        let before = arrived()?;
        let (start, mut sent) = (Instant::now(), 0);
        while start.elapsed() < duration {
            for header in &mut self.headers {
                self.count += 1;
                forward::stamp(header, &self.link, self.count);
            }
            let (to, body) = (self.to, &self.payload);
            let frames = self.headers.iter().map(|header| OutFrame { to, head: header.as_bytes(), body });
            let batch = self.port.data().send_batch(frames);
            ensure!(batch.lost == 0, "the kernel took {} of {BATCH} frames", batch.sent);
            sent += batch.sent as u64;
        }
        let value = start.elapsed().as_nanos() as f64 / sent as f64;
        if sink.is_some() {
            let all = || -> Result<_> { Ok((arrived()? - before >= sent).then_some(())) };
            wait_for("the frames that were sent", PATIENCE, all)?;
        }
        Ok(Sample { value, ..Sample::default() })
    }
}
