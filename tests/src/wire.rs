//! A cable with faults. It carries frames between two interfaces of a namespace, through one
//! [`gdp_faults::Link`] in each direction, in real time.
//!
//! ```text
//!  left ── w0:wire:w1 ── right          this thread: w0 ─► Link ─► w1
//!                                                    w0 ◄─ Link ◄─ w1
//! ```
//!
//! Loss, duplication, delay and damage equal those of the first cable of a [`gdp_faults::Network`]
//! with the same seed in simulated time. Only times are the machine's, never earlier than the
//! model's. [`crate::chain::Chain::disturb_wire`] turns a chain's wire into such a cable.

use std::io::PipeWriter;
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_faults::{Counts, Delivery, Faults, Link, Random};
use parking_lot::Mutex;

use crate::frames::carrier::internet_checksum;
use crate::netns::Namespace;
use crate::packet::{ETHERNET, PacketSocket};

/// The carrying thread. Dropping it ends the thread and thereby cuts the cable.
pub struct Wire {
    links: Arc<Mutex<[Link<Vec<u8>>; 2]>>,
    ports: Arc<[PacketSocket; 2]>,
    began: Instant,
    thread: Option<JoinHandle<Result<()>>>,
    /// Closing this pipe ends the thread.
    running: Option<PipeWriter>,
}

/// Receive buffer of each port, in bytes of frames.
const BACKLOG: i32 = 64 << 20;

impl Wire {
    /// Starts the thread. `faults`: from the first interface to the second, and back. Partitions
    /// count from now.
    pub fn start(at: &Namespace, interfaces: [&str; 2], faults: [Faults; 2], seed: u64) -> Result<Self> {
        for interface in interfaces {
            // GRO must not merge frames into ones that no cable accepts.
            at.ip(&["link", "set", interface, "gro_max_size", "1"])?;
        }
        let open = |interface| PacketSocket::open(at, interface);
        let ports = Arc::new([open(interfaces[0])?, open(interfaces[1])?]);
        ports.iter().try_for_each(|port| port.set_receive_buffer(BACKLOG))?;
        let mut seeds = Random::new(seed);
        let links = Arc::new(Mutex::new(faults.map(|faults| Link::new(faults, seeds.number()))));
        let (stopped, running) = std::io::pipe().context("cannot make a pipe")?;
        let began = Instant::now();
        let thread = {
            let carrier = Carrier { links: links.clone(), ports: ports.clone(), began };
            std::thread::Builder::new().name("wire".into()).spawn(move || carrier.run(stopped.as_raw_fd()))?
        };
        Ok(Self { links, ports, began, thread: Some(thread), running: Some(running) })
    }

    /// Returns the counts of one direction's link: 0 from the first interface, 1 from the second.
    pub fn counts(&self, direction: usize) -> Counts {
        self.links.lock()[direction].counts()
    }

    /// Replaces the faults; their partitions count from now. Frames in flight still arrive.
    pub fn change(&self, faults: [Faults; 2]) {
        let now = since(self.began);
        for (link, mut faults) in self.links.lock().iter_mut().zip(faults) {
            for (from, to) in &mut faults.partitions {
                (*from, *to) = (from.saturating_add(now), to.saturating_add(now));
            }
            link.change(faults);
        }
    }

    /// Fails unless every frame went through the model: the thread runs, and the kernel dropped no
    /// frame before it.
    pub fn check(&self) -> Result<()> {
        ensure!(self.thread.as_ref().is_some_and(|thread| !thread.is_finished()), "the wire has ended");
        for port in self.ports.iter() {
            let dropped = port.dropped()?;
            ensure!(dropped == 0, "{dropped} frames came faster than the wire could carry them");
        }
        Ok(())
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.running = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Err(error))) => eprintln!("the wire: {error:#}"),
            Some(Err(_)) => eprintln!("the wire panicked"),
            _ => {}
        }
    }
}

struct Carrier {
    links: Arc<Mutex<[Link<Vec<u8>>; 2]>>,
    ports: Arc<[PacketSocket; 2]>,
    began: Instant,
}

impl Carrier {
    fn run(&self, stopped: i32) -> Result<()> {
        let mut buffer = vec![0; 1 << 16];
        loop {
            let mut links = self.links.lock();
            for (from, link) in links.iter_mut().enumerate() {
                self.take(from, link, &mut buffer)?;
            }
            for (from, link) in links.iter_mut().enumerate() {
                while let Some(delivery) = link.pop(since(self.began)) {
                    self.deliver(&self.ports[1 - from], delivery)?;
                }
            }
            let next = links.iter().filter_map(Link::next).min();
            drop(links);
            if self.wait(stopped, next)? {
                return Ok(());
            }
        }
    }

    /// Takes the frames that have arrived, up to a bound. A flood in one direction must not delay
    /// frames due in the other.
    fn take(&self, from: usize, link: &mut Link<Vec<u8>>, buffer: &mut [u8]) -> Result<()> {
        const AT_ONCE: usize = 64;
        for _ in 0..AT_ONCE {
            let Some(length) = unplugged(self.ports[from].try_receive(buffer))?.flatten() else { break };
            link.push(since(self.began), buffer[..length].to_vec(), length);
        }
        Ok(())
    }

    fn deliver(&self, port: &PacketSocket, mut delivery: Delivery<Vec<u8>>) -> Result<()> {
        delivery.damage(ETHERNET);
        if delivery.marked {
            mark(&mut delivery.frame);
        }
        self.send(port, &delivery.frame)
    }

    /// Sends a frame, and retries while the short queue of the veth is full.
    fn send(&self, port: &PacketSocket, frame: &[u8]) -> Result<()> {
        const TIMEOUT: Duration = Duration::from_secs(1);
        let deadline = Instant::now() + TIMEOUT;
        loop {
            match unplugged(port.send(frame)).map(|_| ()) {
                Err(error) if is(&error, libc::ENOBUFS) && Instant::now() < deadline => std::thread::yield_now(),
                sent => return sent,
            }
        }
    }

    /// Waits until a frame arrives or is due. Returns true when the thread must end.
    fn wait(&self, stopped: i32, next: Option<u64>) -> Result<bool> {
        let [left, right] = [0, 1].map(|port: usize| self.ports[port].as_raw_fd());
        let mut polls = [left, right, stopped].map(|fd| libc::pollfd { fd, events: libc::POLLIN, revents: 0 });
        let limit = next.map(|next| {
            let left = Duration::from_nanos(next.saturating_sub(since(self.began)));
            libc::timespec { tv_sec: left.as_secs() as libc::time_t, tv_nsec: left.subsec_nanos().into() }
        });
        let limit = limit.as_ref().map_or(std::ptr::null(), |limit| limit as *const libc::timespec);
        // SAFETY: three live pollfds; `limit` is null or points to a live timespec.
        unsafe { libc::ppoll(polls.as_mut_ptr(), polls.len() as libc::nfds_t, limit, std::ptr::null()) };
        Ok(polls[2].revents != 0)
    }
}

/// Ignores that one end of the cable is down.
fn unplugged<T>(result: Result<T>) -> Result<Option<T>> {
    match result {
        Err(error) if is(&error, libc::ENETDOWN) => Ok(None),
        other => other.map(Some),
    }
}

fn is(error: &anyhow::Error, number: i32) -> bool {
    error.downcast_ref::<std::io::Error>().is_some_and(|error| error.raw_os_error() == Some(number))
}

/// Sets Congestion Experienced (RFC 3168) on IP packets whose sender is ECN-capable. Other frames
/// stay unchanged.
fn mark(frame: &mut [u8]) {
    const CE: u8 = 0b11;
    let capable = |codepoint: u8| matches!(codepoint & CE, 0b01 | 0b10);
    let Some((ethernet, packet)) = frame.split_at_mut_checked(ETHERNET) else { return };
    match (&ethernet[12..], packet) {
        ([0x08, 0x00], packet) if packet.len() >= 20 && capable(packet[1]) => {
            packet[1] |= CE;
            let header = usize::from(packet[0] & 0xf) * 4;
            let Some(header) = packet.get_mut(..header.max(20)) else { return };
            header[10..12].fill(0);
            let checksum = internet_checksum(header);
            header[10..12].copy_from_slice(&checksum.to_be_bytes());
        }
        // The low half of the traffic class lies in the second byte.
        ([0x86, 0xdd], packet) if packet.len() >= 40 && capable(packet[1] >> 4) => packet[1] |= CE << 4,
        _ => {}
    }
}

fn since(began: Instant) -> u64 {
    began.elapsed().as_nanos() as u64
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use super::mark;
    use crate::frames::Frame;
    use crate::frames::carrier::{Carrier, internet_checksum};

    #[test]
    fn marks_go_where_they_are_taken_and_leave_a_sound_header() {
        for [from, to] in [["10.0.0.1:1", "10.0.0.2:2"], ["[fd00::1]:1", "[fd00::2]:2"]] {
            let [from, to]: [SocketAddr; 2] = [from, to].map(|address| address.parse().unwrap());
            let datagram = |class| Frame { carrier: Carrier::Udp { from, to, class }, ..Frame::default() }.bytes();
            for (class, marked) in [(0b1010_0010, 0b1010_0011), (0b01, 0b11), (0b11, 0b11), (0, 0)] {
                let mut frame = datagram(class);
                mark(&mut frame);
                assert_eq!(frame, datagram(marked));
                assert!(!from.is_ipv4() || internet_checksum(&frame[14..34]) == 0);
            }
        }
        let (mut frame, plain) = (Frame::default().bytes(), Frame::default().bytes());
        mark(&mut frame);
        mark(&mut [0; 14]);
        assert_eq!(frame, plain);
    }
}
