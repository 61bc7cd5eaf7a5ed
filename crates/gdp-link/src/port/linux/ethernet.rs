//! GDP directly on Ethernet, with two packet sockets per interface.
//!
//! A classic BPF filter on the first byte of a frame separates them. One socket receives control
//! frames, which carry QUIC and discovery; the other receives all other frames. Neither receives
//! frames for other stations or frames with a VLAN tag. Sent frames pass the interface's queueing
//! discipline. Without it, frames would be lost whenever the NIC's ring is full.

use std::ffi::{CStr, CString};
use std::fmt;
use std::io::{self, IoSliceMut};
use std::mem::{size_of, zeroed};
use std::net::SocketAddr;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use gdp_wire::{ControlHeader, FrameType, Name};
use quinn::udp::{RecvMeta, Transmit};
use quinn::{AsyncUdpSocket, UdpPoller};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use tokio::sync::broadcast;
use tokio::time::{Instant, timeout_at};
use zerocopy::IntoBytes;

use super::discover::Discovery;
use super::sys::{self, RawAddr, check, step};
use crate::port::LinkAddr;
use crate::port::addr::{mac_to_socket, socket_to_mac};
use crate::port::batch::{BATCH, RecvBatch};
use crate::port::interface::{Interface, Vlan};

/// Socket buffers. A burst of a 1 MB message in frames of 1500 B occupies about 2 MB of the
/// kernel's memory.
const DATA_BUFFER: usize = 16 << 20;
const CONTROL_BUFFER: usize = 1 << 20;

/// Maximum number of switches in a discovery result.
const MAX_ANSWERS: usize = 64;

/// Interval between two solicitations.
const SOLICIT_INTERVAL: Duration = Duration::from_millis(200);

/// Time to wait for further answers after the first one.
const ANSWERS_SETTLE: Duration = Duration::from_millis(50);

/// Maximum length of a control frame. Longer ones do not parse.
const MAX_CONTROL: usize = 2048;

/// Returns the index of the interface with this name in the network namespace of the calling
/// thread. The interface need not be Ethernet. An interface that is deleted and created again has
/// another index.
pub fn index_of(interface: &str) -> io::Result<u32> {
    let c_name = CString::new(interface).map_err(|_| io::ErrorKind::InvalidInput)?;
    // SAFETY: the pointer refers to a string that ends with 0.
    let index = unsafe { libc::if_nametoindex(c_name.as_ptr()) };
    if index == 0 || interface.len() >= libc::IFNAMSIZ {
        return Err(io::Error::from_raw_os_error(libc::ENODEV));
    }
    Ok(index)
}

/// Looks up an interface by name in the network namespace of the calling thread.
pub fn find(name: &str) -> io::Result<Interface> {
    let index = index_of(name)?;
    // SAFETY: no pointers; `OwnedFd` owns the new descriptor.
    let socket =
        unsafe { OwnedFd::from_raw_fd(check(libc::socket(libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0))?) };
    let ask = |request| {
        // SAFETY: zero is a valid value of every variant.
        let mut ifreq: libc::ifreq = unsafe { zeroed() };
        for (to, from) in ifreq.ifr_name.iter_mut().zip(name.bytes()) {
            *to = from as libc::c_char;
        }
        // SAFETY: both requests used here fill in an `ifreq`.
        check(unsafe { libc::ioctl(socket.as_raw_fd(), request, &raw mut ifreq) }).map(|_| ifreq)
    };
    let hardware = ask(libc::SIOCGIFHWADDR)?;
    let mtu = ask(libc::SIOCGIFMTU)?;
    // SAFETY: the two requests wrote these variants.
    let (hardware, mtu) = unsafe { (hardware.ifr_ifru.ifru_hwaddr, mtu.ifr_ifru.ifru_mtu) };
    if hardware.sa_family != libc::ARPHRD_ETHER {
        return Err(io::Error::new(io::ErrorKind::Unsupported, "not an Ethernet interface"));
    }
    let mut mac = [0; 6];
    for (to, from) in mac.iter_mut().zip(hardware.sa_data) {
        *to = from as u8;
    }
    let vlan = vlan_of(&socket, name);
    Ok(Interface { name: name.to_owned(), index, mac, mtu: mtu.max(0) as u32, vlan })
}

/// The request and answer of the kernel's VLAN driver.
#[repr(C)]
struct VlanRequest {
    command: libc::c_int,
    interface: [u8; 24],
    /// A name, or a number in the first bytes.
    answer: [u8; 24],
    qos: libc::c_short,
}

fn vlan_of(socket: &OwnedFd, name: &str) -> Option<Vlan> {
    const REAL_DEVICE_NAME: libc::c_int = 8;
    const ID: libc::c_int = 9;
    // From linux/sockios.h; missing in libc.
    const SIOCGIFVLAN: libc::c_ulong = 0x8982;
    let ask = |command| {
        let mut request = VlanRequest { command, interface: [0; 24], answer: [0; 24], qos: 0 };
        request.interface[..name.len()].copy_from_slice(name.as_bytes());
        // SAFETY: the request takes this structure (linux/if_vlan.h) and fills it in.
        check(unsafe { libc::ioctl(socket.as_raw_fd(), SIOCGIFVLAN as _, &raw mut request) }).ok()?;
        Some(request.answer)
    };
    let lower = ask(REAL_DEVICE_NAME)?;
    let id = ask(ID)?;
    let lower = CStr::from_bytes_until_nul(&lower).ok()?;
    // SAFETY: the pointer refers to a string that ends with 0.
    let lower_index = unsafe { libc::if_nametoindex(lower.as_ptr()) };
    // The lower interface may be in another network namespace.
    let lower = lower.to_str().ok().filter(|_| lower_index != 0)?.to_owned();
    Some(Vlan { lower, lower_index, id: u16::from_ne_bytes([id[0], id[1]]) })
}

/// Opens the socket for data frames of an interface.
pub fn open_data(interface: &Interface, ethertype: u16) -> io::Result<OwnedFd> {
    open(interface, ethertype, Take::AllButControl)
}

/// Receives the available data frames, at most [`BATCH`].
pub fn receive(fd: BorrowedFd, ifindex: u32, batch: &mut RecvBatch) -> io::Result<()> {
    let mut addrs = [RawAddr::zeroed(); BATCH];
    // SAFETY: both are plain structures of integers and pointers, for which zero is a valid value.
    let (mut iovecs, mut messages): ([libc::iovec; BATCH], [libc::mmsghdr; BATCH]) = unsafe { (zeroed(), zeroed()) };
    let size = batch.largest();
    for (i, slot) in batch.slots(BATCH, size).enumerate() {
        iovecs[i] = libc::iovec { iov_base: slot.as_mut_ptr().cast(), iov_len: slot.len() };
        let header = &mut messages[i].msg_hdr;
        header.msg_name = (&raw mut addrs[i]).cast();
        header.msg_namelen = size_of::<RawAddr>() as u32;
        header.msg_iov = &raw mut iovecs[i];
        header.msg_iovlen = 1;
    }
    // SAFETY: every header points to a buffer and an address with their true lengths. Both outlive
    // the call.
    let count = unsafe { sys::receive(fd, &mut messages) }?;
    for (i, message) in messages[..count].iter().enumerate() {
        let from = LinkAddr::Ethernet { ifindex, mac: addrs[i].mac() };
        batch.add(i * size, message.msg_len as usize, from, false);
    }
    Ok(())
}

/// A socket for quinn that carries QUIC in control frames, and also handles discovery.
pub struct ControlSocket {
    fd: AsyncFd<OwnedFd>,
    interface: Interface,
    ethertype: u16,
    discovery: Discovery,
}

impl ControlSocket {
    /// Opens the socket. `answer_as` is the name with which it answers solicitations.
    pub fn open(interface: &Interface, ethertype: u16, answer_as: Option<Name>) -> io::Result<Self> {
        let fd = open(interface, ethertype, Take::Control)?;
        Ok(Self {
            // SAFETY: an `OwnedFd` is open and names the same file until it is dropped, with the
            // `AsyncFd` around it.
            fd: unsafe { AsyncFd::register(fd) }?,
            interface: interface.clone(),
            ethertype,
            discovery: Discovery::new(answer_as),
        })
    }

    /// Discovers switches, as [`crate::port::Port::discover`] says.
    pub async fn discover(&self, wanted: Option<Name>, within: Duration) -> Vec<(LinkAddr, Name)> {
        let end = Instant::now() + within;
        let (mut answers, mut until, mut next_question) = (self.discovery.listen(), end, Instant::now());
        let mut found: Vec<(LinkAddr, Name)> = Vec::new();
        loop {
            let now = Instant::now();
            if now >= until {
                return found;
            }
            if now >= next_question {
                let _ = self.send([0xff; 6], ControlHeader::SOLICIT, &[]);
                next_question = now + SOLICIT_INTERVAL;
            }
            let (mac, name) = match timeout_at(until.min(next_question), answers.recv()).await {
                Ok(Ok(answer)) => answer,
                Ok(Err(broadcast::error::RecvError::Lagged(_))) | Err(_) => continue,
                Ok(Err(broadcast::error::RecvError::Closed)) => return found,
            };
            let answer = (LinkAddr::Ethernet { ifindex: self.interface.index, mac }, name);
            if wanted.is_none_or(|wanted| wanted == name) {
                if found.len() < MAX_ANSWERS && !found.contains(&answer) {
                    found.push(answer);
                }
                until = end.min(Instant::now() + ANSWERS_SETTLE);
            }
        }
    }

    /// Sends one control frame. The frame is lost when the kernel has no buffer space: QUIC and
    /// discovery both retransmit.
    fn send(&self, to: [u8; 6], kind: u8, payload: &[u8]) -> io::Result<()> {
        let Ok(length) = u16::try_from(payload.len()) else { return Ok(()) };
        let header = ControlHeader::new(kind, length);
        let mut iovecs = [header.as_bytes(), payload]
            .map(|piece| libc::iovec { iov_base: piece.as_ptr().cast_mut().cast(), iov_len: piece.len() });
        let mut addr = RawAddr::station(self.interface.index, to, self.ethertype);
        // SAFETY: zero is a valid value of the structure.
        let mut message: libc::msghdr = unsafe { zeroed() };
        message.msg_name = (&raw mut addr).cast();
        message.msg_namelen = size_of::<libc::sockaddr_ll>() as u32;
        message.msg_iov = iovecs.as_mut_ptr();
        message.msg_iovlen = 2;
        // SAFETY: the message points to an address and pieces that outlive the call; the kernel
        // only reads them.
        if unsafe { libc::sendmsg(self.fd.as_raw_fd(), &message, libc::MSG_DONTWAIT) } < 0 {
            return Err(io::Error::last_os_error());
        }
        Ok(())
    }

    /// Receives one frame. Moves its payload to the front of `buffer`, and returns the sender, the
    /// kind and the payload length.
    fn receive(&self, buffer: &mut [u8; MAX_CONTROL]) -> io::Result<Option<([u8; 6], u8, usize)>> {
        let mut addr = RawAddr::zeroed();
        let mut addr_len = size_of::<RawAddr>() as u32;
        // SAFETY: buffer and address have the given lengths and outlive the call.
        let length = unsafe {
            libc::recvfrom(
                self.fd.as_raw_fd(),
                buffer.as_mut_ptr().cast(),
                buffer.len(),
                libc::MSG_DONTWAIT,
                (&raw mut addr).cast(),
                &mut addr_len,
            )
        };
        if length < 0 {
            return Err(io::Error::last_os_error());
        }
        let Some((kind, payload)) = ControlHeader::parse(&buffer[..length as usize]) else { return Ok(None) };
        let payload_len = payload.len();
        buffer.copy_within(ControlHeader::LEN..ControlHeader::LEN + payload_len, 0);
        Ok(Some((addr.mac(), kind, payload_len)))
    }
}

impl AsyncUdpSocket for ControlSocket {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        Box::pin(Poller(self))
    }

    fn try_send(&self, transmit: &Transmit) -> io::Result<()> {
        let to = socket_to_mac(&transmit.destination);
        match self.fd.try_io(Interest::WRITABLE, |_| self.send(to, ControlHeader::QUIC, transmit.contents)) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Err(error),
            // QUIC treats any other error as a lost packet. Returning it would end the whole
            // endpoint.
            _ => Ok(()),
        }
    }

    fn poll_recv(
        &self,
        cx: &mut Context,
        bufs: &mut [IoSliceMut<'_>],
        meta: &mut [RecvMeta],
    ) -> Poll<io::Result<usize>> {
        let mut scratch = [0; MAX_CONTROL];
        loop {
            let mut ready = ready!(self.fd.poll_read_ready(cx))?;
            let (mut count, mut drained) = (0, false);
            // The bound includes frames without a QUIC packet, because a flood of them must not
            // block this task.
            for _ in 0..bufs.len() {
                match ready.try_io(|_| self.receive(&mut scratch)) {
                    Ok(Ok(Some((from, ControlHeader::QUIC, length)))) if length <= bufs[count].len() => {
                        bufs[count][..length].copy_from_slice(&scratch[..length]);
                        meta[count] = RecvMeta {
                            addr: mac_to_socket(from),
                            len: length,
                            stride: length,
                            ecn: None,
                            dst_ip: None,
                        };
                        count += 1;
                    }
                    Ok(Ok(Some((from, kind, length)))) => self.take_discovery(from, kind, &scratch[..length]),
                    Ok(Ok(None)) => {}
                    // The interface went down or was removed. The links on it time out; the
                    // interface may come up again.
                    Ok(Err(_)) => {}
                    Err(_would_block) => {
                        drained = true;
                        break;
                    }
                }
            }
            if count > 0 {
                return Poll::Ready(Ok(count));
            }
            if !drained {
                cx.waker().wake_by_ref();
                return Poll::Pending;
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(mac_to_socket(self.interface.mac))
    }

    fn may_fragment(&self) -> bool {
        false
    }
}

impl ControlSocket {
    fn take_discovery(&self, from: [u8; 6], kind: u8, payload: &[u8]) {
        match kind {
            ControlHeader::SOLICIT => {
                if let Some(name) = self.discovery.answer() {
                    let _ = self.send(from, ControlHeader::ANSWER, name.as_bytes());
                }
            }
            ControlHeader::ANSWER => {
                if let Ok(bytes) = <[u8; 32]>::try_from(payload) {
                    self.discovery.answered(from, Name::from_bytes(bytes));
                }
            }
            _ => {}
        }
    }
}

impl fmt::Debug for ControlSocket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ControlSocket({})", self.interface.name)
    }
}

#[derive(Debug)]
struct Poller(Arc<ControlSocket>);

impl UdpPoller for Poller {
    fn poll_writable(self: Pin<&mut Self>, cx: &mut Context) -> Poll<io::Result<()>> {
        self.0.fd.poll_write_ready(cx).map_ok(drop)
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Take {
    Control,
    AllButControl,
}

/// Opens a packet socket that receives no frame that its filter rejects. The socket is bound after
/// the filter is attached.
fn open(interface: &Interface, ethertype: u16, take: Take) -> io::Result<OwnedFd> {
    // SAFETY: no pointers; `OwnedFd` owns the new descriptor. Protocol 0 receives nothing.
    let fd = unsafe {
        let flags = libc::SOCK_DGRAM | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
        OwnedFd::from_raw_fd(check(libc::socket(libc::AF_PACKET, flags, 0))?)
    };
    let buffer = if take == Take::Control { CONTROL_BUFFER } else { DATA_BUFFER };
    sys::set_buffers(&fd, buffer, buffer / 4);
    attach_filter(&fd, take)?;
    let addr = RawAddr::station(interface.index, [0; 6], ethertype);
    // SAFETY: the pointer refers to an address of the given length.
    check(unsafe { libc::bind(fd.as_raw_fd(), (&raw const addr).cast(), size_of::<libc::sockaddr_ll>() as u32) })?;
    Ok(fd)
}

fn attach_filter(fd: &OwnedFd, take: Take) -> io::Result<()> {
    const LOAD_BYTE: u32 = libc::BPF_LD | libc::BPF_B | libc::BPF_ABS;
    const JUMP_EQUAL: u32 = libc::BPF_JMP | libc::BPF_JEQ | libc::BPF_K;
    const RETURN: u32 = libc::BPF_RET | libc::BPF_K;
    let packet_type = (libc::SKF_AD_OFF + libc::SKF_AD_PKTTYPE) as u32;
    let (control, other) = if take == Take::Control { (0, 1) } else { (1, 0) };
    let mut program = [
        step(LOAD_BYTE, 0, 0, packet_type),
        step(JUMP_EQUAL, 4, 0, libc::PACKET_OTHERHOST.into()),
        step(JUMP_EQUAL, 3, 0, libc::PACKET_OUTGOING.into()),
        step(LOAD_BYTE, 0, 0, 0),
        step(JUMP_EQUAL, control, other, FrameType::Control.first_byte().into()),
        step(RETURN, 0, 0, u32::MAX),
        step(RETURN, 0, 0, 0),
    ];
    sys::attach_program(fd.as_fd(), libc::SO_ATTACH_FILTER, &mut program)
}
