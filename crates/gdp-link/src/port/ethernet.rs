//! GDP directly on Ethernet. Two packet sockets to an interface, told apart by a classic BPF filter
//! on the first byte of the frame: one for control frames, which carries QUIC and discovery, one
//! for all the others. Neither sees frames for other stations, nor those with a VLAN tag. What is
//! sent passes the interface's queueing discipline: without it, frames would be lost whenever the
//! ring of a NIC is full.

use std::ffi::{CStr, CString};
use std::fmt;
use std::io::{self, IoSliceMut};
use std::mem::{size_of, zeroed};
use std::net::SocketAddr;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use gdp_wire::{ControlHeader, FrameType, Name};
use quinn::udp::{RecvMeta, Transmit};
use quinn::{AsyncUdpSocket, UdpPoller};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use zerocopy::IntoBytes;

use super::LinkAddr;
use super::addr::{mac_to_socket, socket_to_mac};
use super::batch::{BATCH, RecvBatch};
use super::discover::Discovery;
use super::sys::{self, RawAddr, check, step};

/// Socket buffers. A burst of a 1 MB message in frames of 1500 B occupies about 2 MB of the
/// kernel's memory.
const DATA_BUFFER: usize = 16 << 20;
const CONTROL_BUFFER: usize = 1 << 20;

/// Longest control frame that is read; longer ones do not parse.
const MAX_CONTROL: usize = 2048;

/// What the kernel says of an interface.
#[derive(Clone, Debug)]
pub struct Interface {
    pub name: String,
    pub index: u32,
    pub mac: [u8; 6],
    /// Bytes behind the Ethernet header.
    pub mtu: u32,
    /// If it is one: the VLAN that it is, on another interface.
    pub vlan: Option<Vlan>,
}

/// A VLAN on an interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vlan {
    /// The interface that takes the tagged frames.
    pub lower: String,
    /// Its index.
    pub lower_index: u32,
    /// Of IEEE 802.1Q.
    pub id: u16,
}

/// Index of the interface of that name, Ethernet or not, in the network namespace of the calling
/// thread. One that is made anew has another.
pub fn index_of(interface: &str) -> io::Result<u32> {
    let c_name = CString::new(interface).map_err(|_| io::ErrorKind::InvalidInput)?;
    // SAFETY: a string that ends with 0.
    let index = unsafe { libc::if_nametoindex(c_name.as_ptr()) };
    if index == 0 || interface.len() >= libc::IFNAMSIZ {
        return Err(io::Error::from_raw_os_error(libc::ENODEV));
    }
    Ok(index)
}

impl Interface {
    /// Looks an interface up by name in the network namespace of the calling thread.
    pub fn find(name: &str) -> io::Result<Self> {
        let index = index_of(name)?;
        // SAFETY: no pointers; the descriptor is owned from here on.
        let socket = unsafe {
            OwnedFd::from_raw_fd(check(libc::socket(libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0))?)
        };
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
        // SAFETY: the variants that the two requests wrote.
        let (hardware, mtu) = unsafe { (hardware.ifr_ifru.ifru_hwaddr, mtu.ifr_ifru.ifru_mtu) };
        if hardware.sa_family != libc::ARPHRD_ETHER {
            return Err(io::Error::new(io::ErrorKind::Unsupported, "not an Ethernet interface"));
        }
        let mut mac = [0; 6];
        for (to, from) in mac.iter_mut().zip(hardware.sa_data) {
            *to = from as u8;
        }
        let vlan = Vlan::of(&socket, name);
        Ok(Self { name: name.to_owned(), index, mac, mtu: mtu.max(0) as u32, vlan })
    }
}

/// What the kernel's VLAN driver is asked with, and answers.
#[repr(C)]
struct VlanRequest {
    command: libc::c_int,
    interface: [u8; 24],
    /// A name, or a number in the first bytes.
    answer: [u8; 24],
    qos: libc::c_short,
}

impl Vlan {
    fn of(socket: &OwnedFd, name: &str) -> Option<Self> {
        const REAL_DEVICE_NAME: libc::c_int = 8;
        const ID: libc::c_int = 9;
        // linux/sockios.h; not in libc.
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
        // SAFETY: a string that ends with 0.
        let lower_index = unsafe { libc::if_nametoindex(lower.as_ptr()) };
        // It may be in another network namespace.
        let lower = lower.to_str().ok().filter(|_| lower_index != 0)?.to_owned();
        Some(Self { lower, lower_index, id: u16::from_ne_bytes([id[0], id[1]]) })
    }
}

/// The socket for data frames of an interface.
pub fn open_data(interface: &Interface, ethertype: u16) -> io::Result<OwnedFd> {
    open(interface, ethertype, Take::AllButControl)
}

/// Receives the data frames that are there, [`BATCH`] at most.
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
    // SAFETY: every header points to a buffer and an address that outlive the call, with their true
    // lengths.
    let count = unsafe { sys::receive(fd, &mut messages) }?;
    for (i, message) in messages[..count].iter().enumerate() {
        let from = LinkAddr::Ethernet { ifindex, mac: addrs[i].mac() };
        batch.add(i * size, message.msg_len as usize, from, false);
    }
    Ok(())
}

/// QUIC over control frames, as quinn wants a socket to be; and discovery beside it.
pub struct ControlSocket {
    fd: AsyncFd<OwnedFd>,
    interface: Interface,
    ethertype: u16,
    pub discovery: Discovery,
}

impl ControlSocket {
    /// `answer_as`: the name solicitations are answered with.
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

    /// Sends one control frame. Lost when the kernel has no room: QUIC and discovery both try
    /// again.
    pub fn send(&self, to: [u8; 6], kind: u8, payload: &[u8]) -> io::Result<()> {
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

    /// Receives one frame; the kind and length of its payload, which is moved to the front of
    /// `buffer`.
    fn receive(&self, buffer: &mut [u8; MAX_CONTROL]) -> io::Result<Option<([u8; 6], u8, usize)>> {
        let mut addr = RawAddr::zeroed();
        let mut addr_len = size_of::<RawAddr>() as u32;
        // SAFETY: buffer and address are as long as said and outlive the call.
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
            // Any other error is a lost packet to QUIC; an error returned here would end the whole
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
            // What is no QUIC packet is bounded too, so that a flood of it cannot hold this task.
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
                    Ok(Ok(Some((from, kind, length)))) => self.discover(from, kind, &scratch[..length]),
                    Ok(Ok(None)) => {}
                    // The interface went down or away. The links on it time out; it may come up
                    // again.
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
    fn discover(&self, from: [u8; 6], kind: u8, payload: &[u8]) {
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

/// A packet socket that never held a frame its filter would refuse: it is bound only after the
/// filter is in place.
fn open(interface: &Interface, ethertype: u16, take: Take) -> io::Result<OwnedFd> {
    // SAFETY: no pointers; the descriptor is owned from here on. Protocol 0 receives nothing.
    let fd = unsafe {
        let flags = libc::SOCK_DGRAM | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
        OwnedFd::from_raw_fd(check(libc::socket(libc::AF_PACKET, flags, 0))?)
    };
    let buffer = if take == Take::Control { CONTROL_BUFFER } else { DATA_BUFFER };
    sys::set_buffers(fd.as_fd(), buffer, buffer / 4);
    attach_filter(&fd, take)?;
    let addr = RawAddr::station(interface.index, [0; 6], ethertype);
    // SAFETY: an address of the length given.
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
