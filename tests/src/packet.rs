//! Raw Ethernet frames on an interface: captures traffic, and injects frames that no honest node
//! would send.

use std::io::{Error, ErrorKind};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use crate::netns::Namespace;

/// The ethertype of GDP frames.
pub const GDP_ETHERTYPE: u16 = 0x88b5;

/// Bytes of an Ethernet header.
pub const ETHERNET: usize = 14;

/// A promiscuous packet socket on one interface. It receives frames that arrive there, not frames
/// that leave.
pub struct PacketSocket {
    socket: OwnedFd,
}

impl PacketSocket {
    pub fn open(namespace: &Namespace, interface: &str) -> Result<Self> {
        let _inside = namespace.enter()?;
        Self::open_here(interface)
            .with_context(|| format!("cannot open a packet socket on {interface} in {}", namespace.name()))
    }

    fn open_here(interface: &str) -> std::io::Result<Self> {
        let name = std::ffi::CString::new(interface).map_err(|_| Error::from(ErrorKind::InvalidInput))?;
        // SAFETY: `name` is a C string.
        let index = check(unsafe { libc::if_nametoindex(name.as_ptr()) } as libc::c_int).and_then(|i| match i {
            0 => Err(Error::last_os_error()),
            i => Ok(i),
        })?;
        let protocol = (libc::ETH_P_ALL as u16).to_be();
        // SAFETY: no pointers; the descriptor is owned at once.
        let socket = unsafe {
            let fd = check(libc::socket(libc::AF_PACKET, libc::SOCK_RAW | libc::SOCK_CLOEXEC, protocol.into()))?;
            OwnedFd::from_raw_fd(fd)
        };
        // SAFETY: all-zero is a valid sockaddr_ll.
        let mut address: libc::sockaddr_ll = unsafe { std::mem::zeroed() };
        address.sll_family = libc::AF_PACKET as u16;
        address.sll_protocol = protocol;
        address.sll_ifindex = index;
        // SAFETY: pointer and length are of one live sockaddr_ll.
        check(unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), size_of_val(&address) as u32) })?;
        let membership = libc::packet_mreq {
            mr_ifindex: index,
            mr_type: libc::PACKET_MR_PROMISC as u16,
            mr_alen: 0,
            mr_address: [0; 8],
        };
        set_option(&socket, libc::PACKET_ADD_MEMBERSHIP, &membership)?;
        const PACKET_IGNORE_OUTGOING: libc::c_int = 23;
        set_option(&socket, PACKET_IGNORE_OUTGOING, &1i32)?;
        Ok(Self { socket })
    }

    /// Returns the next frame that `wanted` accepts, with its Ethernet header. Fails after `limit`.
    pub fn receive(&self, limit: Duration, wanted: impl Fn(&[u8]) -> bool) -> Result<Vec<u8>> {
        let deadline = Instant::now() + limit;
        let mut buffer = vec![0u8; 1 << 16];
        loop {
            crate::wait::check_interrupt()?;
            let left = deadline.saturating_duration_since(Instant::now());
            anyhow::ensure!(!left.is_zero(), "no such frame within {limit:?}");
            let mut poll = libc::pollfd { fd: self.socket.as_raw_fd(), events: libc::POLLIN, revents: 0 };
            // SAFETY: one live pollfd.
            unsafe { libc::poll(&raw mut poll, 1, left.as_millis().clamp(1, 100) as libc::c_int) };
            if poll.revents == 0 {
                continue;
            }
            // SAFETY: the buffer has the given length.
            let n = unsafe { libc::recv(self.socket.as_raw_fd(), buffer.as_mut_ptr().cast(), buffer.len(), 0) };
            let length = usize::try_from(n).map_err(|_| Error::last_os_error()).context("packet socket")?;
            if wanted(&buffer[..length]) {
                return Ok(buffer[..length].to_vec());
            }
        }
    }

    /// Returns the length of a frame that has arrived, or `None`.
    pub fn try_receive(&self, buffer: &mut [u8]) -> Result<Option<usize>> {
        let (fd, flags) = (self.socket.as_raw_fd(), libc::MSG_DONTWAIT);
        // SAFETY: the buffer has the given length.
        let n = unsafe { libc::recv(fd, buffer.as_mut_ptr().cast(), buffer.len(), flags) };
        match usize::try_from(n).map_err(|_| Error::last_os_error()) {
            Ok(length) => Ok(Some(length)),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error).context("packet socket"),
        }
    }

    /// Returns the number of frames lost to a full receive buffer since the last call.
    pub fn dropped(&self) -> Result<u32> {
        let mut statistics = libc::tpacket_stats { tp_packets: 0, tp_drops: 0 };
        let mut length = size_of_val(&statistics) as u32;
        let (fd, pointer) = (self.socket.as_raw_fd(), (&raw mut statistics).cast());
        // SAFETY: pointer and length are of one live tpacket_stats.
        let result =
            unsafe { libc::getsockopt(fd, libc::SOL_PACKET, libc::PACKET_STATISTICS, pointer, &raw mut length) };
        check(result).context("cannot read the statistics of a packet socket")?;
        Ok(statistics.tp_drops)
    }

    /// Sets the receive buffer, in bytes, beyond the system's limit for unprivileged users.
    pub fn set_receive_buffer(&self, bytes: i32) -> Result<()> {
        let (pointer, length) = ((&raw const bytes).cast(), size_of::<i32>() as u32);
        // SAFETY: pointer and length are of one live integer.
        check(unsafe {
            libc::setsockopt(self.socket.as_raw_fd(), libc::SOL_SOCKET, libc::SO_RCVBUFFORCE, pointer, length)
        })
        .map(drop)
        .context("cannot set a receive buffer")
    }

    /// Sends a frame unchanged, Ethernet header included.
    pub fn send(&self, frame: &[u8]) -> Result<()> {
        // SAFETY: the buffer has the given length.
        let n = unsafe { libc::send(self.socket.as_raw_fd(), frame.as_ptr().cast(), frame.len(), 0) };
        if n < 0 { Err(Error::last_os_error()).context("cannot send a frame") } else { Ok(()) }
    }
}

impl AsRawFd for PacketSocket {
    fn as_raw_fd(&self) -> RawFd {
        self.socket.as_raw_fd()
    }
}

/// The first byte of a data frame.
const DATA: u8 = 0x20;

/// Returns whether this Ethernet frame is a GDP data frame.
pub fn is_gdp_data(frame: &[u8]) -> bool {
    frame.len() > ETHERNET && frame[12..14] == GDP_ETHERTYPE.to_be_bytes() && frame[ETHERNET] == DATA
}

/// Returns the offset of the GDP frame in this Ethernet frame, if that contains a data frame in UDP
/// over IPv4.
pub fn gdp_data_in_udp(frame: &[u8]) -> Option<usize> {
    const IPV4: [u8; 2] = [8, 0];
    const UDP_HEADER: usize = 8;
    let words = usize::from(frame.get(ETHERNET)? & 0xf);
    let is_udp = frame[12..14] == IPV4 && i32::from(*frame.get(ETHERNET + 9)?) == libc::IPPROTO_UDP;
    let start = ETHERNET + 4 * words + UDP_HEADER;
    (is_udp && *frame.get(start)? == DATA).then_some(start)
}

fn set_option<T>(socket: &OwnedFd, option: libc::c_int, value: &T) -> std::io::Result<()> {
    let (pointer, length) = ((&raw const *value).cast(), size_of::<T>() as u32);
    // SAFETY: pointer and length are of one live value of the type the option takes.
    check(unsafe { libc::setsockopt(socket.as_raw_fd(), libc::SOL_PACKET, option, pointer, length) }).map(drop)
}

fn check(result: libc::c_int) -> std::io::Result<libc::c_int> {
    if result < 0 { Err(Error::last_os_error()) } else { Ok(result) }
}
