//! A network that delivers every datagram twice.

use std::fs;
use std::io::PipeWriter;
use std::os::fd::AsRawFd;
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use gdp_tests::netns::Namespace;
use gdp_tests::packet::{ETHERNET, PacketSocket};

/// Sends each datagram to a user data port on a loopback interface a second time, until this guard
/// is dropped.
pub struct Doubler {
    thread: Option<JoinHandle<Result<()>>>,
    /// Closing this pipe ends the thread.
    running: Option<PipeWriter>,
}

impl Doubler {
    pub fn start(at: &Namespace) -> Result<Self> {
        {
            let _inside = at.enter()?;
            // Otherwise the kernel drops the copies, because their source addresses are the host's
            // own.
            for (setting, value) in [("accept_local", "1"), ("route_localnet", "1"), ("rp_filter", "0")] {
                for scope in ["all", "lo"] {
                    fs::write(format!("/proc/sys/net/ipv4/conf/{scope}/{setting}"), value)
                        .with_context(|| format!("cannot set {setting} in {}", at.name()))?;
                }
            }
        }
        let socket = PacketSocket::open(at, "lo")?;
        socket.set_receive_buffer(64 << 20)?;
        let (stopped, running) = std::io::pipe()?;
        let thread = std::thread::spawn(move || {
            let mut buffer = vec![0; 1 << 17];
            loop {
                let mut polls = [socket.as_raw_fd(), stopped.as_raw_fd()].map(readable);
                // SAFETY: two live pollfds.
                unsafe { libc::poll(polls.as_mut_ptr(), polls.len() as libc::nfds_t, -1) };
                if polls[1].revents != 0 {
                    return Ok(());
                }
                while let Some(length) = socket.try_receive(&mut buffer)? {
                    if mark_copy(&mut buffer[..length]) {
                        socket.send(&buffer[..length])?;
                    }
                }
            }
        });
        Ok(Self { thread: Some(thread), running: Some(running) })
    }
}

impl Drop for Doubler {
    fn drop(&mut self) {
        self.running = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Ok(()))) | None => {}
            Some(failed) => eprintln!("the doubler: {failed:?}"),
        }
    }
}

fn readable(fd: i32) -> libc::pollfd {
    libc::pollfd { fd, events: libc::POLLIN, revents: 0 }
}

/// Marks a datagram to the user data port of the first participants of domain 0 as a copy. Returns
/// false for other frames, and for copies.
fn mark_copy(frame: &mut [u8]) -> bool {
    /// A byte of the source MAC address, which is zero on a loopback interface.
    const MARK: usize = 6;
    const UDP: usize = ETHERNET + 20;
    const PORTS: std::ops::Range<u16> = 7411..7431;
    let Some(udp) = frame.get(UDP..UDP + 8) else { return false };
    let port = u16::from_be_bytes([udp[2], udp[3]]);
    let is_udp = frame[12..14] == [8, 0] && i32::from(frame[ETHERNET + 9]) == libc::IPPROTO_UDP;
    if !is_udp || frame[MARK] != 0 || !PORTS.contains(&port) || port % 2 == 0 {
        return false;
    }
    frame[MARK] = 2;
    // No checksum: on loopback, the kernel leaves the checksum to a forwarder.
    frame[UDP + 6..UDP + 8].fill(0);
    true
}
