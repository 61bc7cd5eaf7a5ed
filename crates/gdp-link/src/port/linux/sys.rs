//! Wrappers of the system calls that ports need and the standard library lacks.

use std::io;
use std::mem::{size_of, size_of_val, zeroed};
use std::net::{SocketAddr, SocketAddrV4, SocketAddrV6, UdpSocket};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

/// Binds a socket to one interface for sending and receiving.
pub fn bind_to_interface(fd: BorrowedFd, interface: &str) -> io::Result<()> {
    // The kernel accepts names of at most this length, including the terminating zero.
    let mut name = [0u8; libc::IFNAMSIZ];
    let long = || io::Error::new(io::ErrorKind::InvalidInput, "the name of the interface is too long");
    name[..libc::IFNAMSIZ - 1].get_mut(..interface.len()).ok_or_else(long)?.copy_from_slice(interface.as_bytes());
    set_option(fd, libc::SOL_SOCKET, libc::SO_BINDTODEVICE, &name)
}

/// Opens a non-blocking UDP socket at an address that another socket shares, bound to the same
/// interface.
pub fn bind_shared_udp(addr: SocketAddr, interface: Option<&str>) -> io::Result<UdpSocket> {
    let family = if addr.is_ipv6() { libc::AF_INET6 } else { libc::AF_INET };
    // SAFETY: no pointers; `OwnedFd` owns the new descriptor.
    let socket = unsafe {
        let flags = libc::SOCK_DGRAM | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
        OwnedFd::from_raw_fd(check(libc::socket(family, flags, 0))?)
    };
    set_option(socket.as_fd(), libc::SOL_SOCKET, libc::SO_REUSEPORT, &1i32)?;
    if let Some(interface) = interface {
        bind_to_interface(socket.as_fd(), interface)?;
    }
    let (raw, length) = RawAddr::socket(addr, addr.is_ipv6());
    // SAFETY: the pointer refers to an address of the given length.
    check(unsafe { libc::bind(socket.as_raw_fd(), (&raw const raw).cast(), length) })?;
    Ok(socket.into())
}

/// Removes the peer of a UDP socket, and the address and port that the kernel chose for it.
pub fn disconnect(fd: BorrowedFd) -> io::Result<()> {
    // The family of a zeroed address is AF_UNSPEC.
    let nobody = RawAddr::zeroed();
    // SAFETY: the pointer refers to an address of the given length.
    check(unsafe { libc::connect(fd.as_raw_fd(), (&raw const nobody).cast(), size_of::<RawAddr>() as u32) }).map(drop)
}

/// Converts the usual −1 into the error in `errno`.
pub fn check(result: libc::c_int) -> io::Result<libc::c_int> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(result) }
}

pub fn set_option<T>(fd: BorrowedFd, level: libc::c_int, option: libc::c_int, value: &T) -> io::Result<()> {
    // SAFETY: the pointer and the length describe `value`, which outlives the call.
    check(unsafe {
        libc::setsockopt(fd.as_raw_fd(), level, option, (&raw const *value).cast(), size_of_val(value) as u32)
    })
    .map(drop)
}

/// Returns a socket option. `T` is an integer of the option's size.
pub fn get_option<T: Copy + Default>(fd: BorrowedFd, level: libc::c_int, option: libc::c_int) -> io::Result<T> {
    let mut value = T::default();
    let mut length = size_of::<T>() as u32;
    // SAFETY: the kernel writes at most `length` bytes into `value`. The callers use integers, for
    // which all bytes are valid.
    check(unsafe { libc::getsockopt(fd.as_raw_fd(), level, option, (&raw mut value).cast(), &raw mut length) })?;
    Ok(value)
}

/// Requests socket buffers of the given sizes, in bytes. With CAP_NET_ADMIN they may exceed the
/// system's limit.
pub fn set_buffers(socket: &impl AsFd, receive: usize, send: usize) {
    let fd = socket.as_fd();
    for (bytes, force, polite) in
        [(receive, libc::SO_RCVBUFFORCE, libc::SO_RCVBUF), (send, libc::SO_SNDBUFFORCE, libc::SO_SNDBUF)]
    {
        let bytes = bytes as libc::c_int;
        if set_option(fd, libc::SOL_SOCKET, force, &bytes).is_err() {
            // A smaller buffer is no error: its effect is visible in the drop counters.
            let _ = set_option(fd, libc::SOL_SOCKET, polite, &bytes);
        }
    }
}

/// Limits the bytes that the kernel holds unsent for a TCP connection.
pub fn limit_unsent(socket: &impl AsFd, bytes: u32) -> io::Result<()> {
    set_option(socket.as_fd(), libc::IPPROTO_TCP, libc::TCP_NOTSENT_LOWAT, &bytes)
}

/// Returns the number of frames that the kernel dropped since the socket was opened, because the
/// receive buffer was full.
pub fn receive_drops(fd: BorrowedFd) -> u64 {
    const SK_MEMINFO_DROPS: usize = 8;
    memory(fd)[SK_MEMINFO_DROPS].into()
}

/// Returns the bytes of memory for frames that the socket has sent and no interface has taken yet.
pub fn send_queue(fd: BorrowedFd) -> usize {
    const SK_MEMINFO_WMEM_ALLOC: usize = 2;
    memory(fd)[SK_MEMINFO_WMEM_ALLOC] as usize
}

/// Returns the kernel's memory statistics of a socket (linux/sock_diag.h).
fn memory(fd: BorrowedFd) -> [u32; 9] {
    const SO_MEMINFO: libc::c_int = 55;
    let mut info = [0u32; 9];
    let mut length = size_of_val(&info) as u32;
    // SAFETY: the kernel writes at most `length` bytes into `info`.
    let result = unsafe {
        libc::getsockopt(fd.as_raw_fd(), libc::SOL_SOCKET, SO_MEMINFO, info.as_mut_ptr().cast(), &mut length)
    };
    if result == 0 { info } else { [0; 9] }
}

/// Receives the available datagrams or frames, one per message, and returns their number.
///
/// # Safety
///
/// The memory that the messages point to must have the stated lengths. No other code may use it
/// until this function returns.
pub unsafe fn receive(fd: BorrowedFd, messages: &mut [libc::mmsghdr]) -> io::Result<usize> {
    let (count, flags, no_timeout) = (messages.len() as u32, libc::MSG_DONTWAIT, std::ptr::null_mut());
    loop {
        // SAFETY: guaranteed by the caller.
        let result = unsafe { libc::recvmmsg(fd.as_raw_fd(), messages.as_mut_ptr(), count, flags as _, no_timeout) };
        let Err(error) = check(result) else { return Ok(result as usize) };
        match error.raw_os_error() {
            Some(libc::EINTR) => {}
            // The kernel reports ENETDOWN once after the interface went down. The interface may
            // come up again.
            Some(libc::EAGAIN | libc::ENETDOWN) => return Ok(0),
            _ => return Err(error),
        }
    }
}

/// Attaches a classic BPF program. It is a filter (`SO_ATTACH_FILTER`) or selects among the sockets
/// of one port (`SO_ATTACH_REUSEPORT_CBPF`).
pub fn attach_program(fd: BorrowedFd, option: libc::c_int, program: &mut [libc::sock_filter]) -> io::Result<()> {
    let program = libc::sock_fprog { len: program.len() as u16, filter: program.as_mut_ptr() };
    set_option(fd, libc::SOL_SOCKET, option, &program)
}

/// Returns a classic BPF instruction.
pub const fn step(code: u32, jump_true: u8, jump_false: u8, k: u32) -> libc::sock_filter {
    libc::sock_filter { code: code as u16, jt: jump_true, jf: jump_false, k }
}

/// A socket address in the kernel's format, for the `mmsg` system calls.
#[derive(Clone, Copy)]
#[repr(C)]
pub union RawAddr {
    pub link: libc::sockaddr_ll,
    pub v4: libc::sockaddr_in,
    pub v6: libc::sockaddr_in6,
}

impl RawAddr {
    pub fn zeroed() -> Self {
        // SAFETY: all three variants are plain integers.
        unsafe { zeroed() }
    }

    /// Returns the address of a station on the segment of an interface.
    pub fn station(ifindex: u32, mac: [u8; 6], ethertype: u16) -> Self {
        let mut raw = Self::zeroed();
        let mut link = libc::sockaddr_ll {
            sll_family: libc::AF_PACKET as u16,
            sll_protocol: ethertype.to_be(),
            sll_ifindex: ifindex as i32,
            sll_hatype: 0,
            sll_pkttype: 0,
            sll_halen: 6,
            sll_addr: [0; 8],
        };
        link.sll_addr[..6].copy_from_slice(&mac);
        raw.link = link;
        raw
    }

    /// Returns the sender's MAC address from an address that a packet socket wrote.
    pub fn mac(&self) -> [u8; 6] {
        // SAFETY: all variants are plain integers, valid for any bytes.
        let address = unsafe { self.link.sll_addr };
        [address[0], address[1], address[2], address[3], address[4], address[5]]
    }

    /// Returns an IP address in the format for a socket of the given family, and its length. An
    /// IPv6 socket takes IPv4-mapped addresses.
    pub fn socket(addr: SocketAddr, v6_socket: bool) -> (Self, u32) {
        let mut raw = Self::zeroed();
        match addr {
            SocketAddr::V4(v4) if !v6_socket => {
                raw.v4 = libc::sockaddr_in {
                    sin_family: libc::AF_INET as u16,
                    sin_port: v4.port().to_be(),
                    sin_addr: libc::in_addr { s_addr: u32::from_ne_bytes(v4.ip().octets()) },
                    sin_zero: [0; 8],
                };
                (raw, size_of::<libc::sockaddr_in>() as u32)
            }
            addr => {
                let (ip, flow, scope) = match addr {
                    SocketAddr::V4(v4) => (v4.ip().to_ipv6_mapped(), 0, 0),
                    SocketAddr::V6(v6) => (*v6.ip(), v6.flowinfo(), v6.scope_id()),
                };
                raw.v6 = libc::sockaddr_in6 {
                    sin6_family: libc::AF_INET6 as u16,
                    sin6_port: addr.port().to_be(),
                    sin6_flowinfo: flow.to_be(),
                    sin6_addr: libc::in6_addr { s6_addr: ip.octets() },
                    sin6_scope_id: scope,
                };
                (raw, size_of::<libc::sockaddr_in6>() as u32)
            }
        }
    }
    /// Returns the sender's address from an address that an IP socket wrote.
    pub fn socket_addr(&self) -> Option<SocketAddr> {
        // SAFETY: all three variants begin with the family, and are plain integers, valid for any
        // bytes.
        unsafe {
            match libc::c_int::from(self.link.sll_family) {
                libc::AF_INET => {
                    let v4 = self.v4;
                    let ip = v4.sin_addr.s_addr.to_ne_bytes().into();
                    Some(SocketAddrV4::new(ip, u16::from_be(v4.sin_port)).into())
                }
                libc::AF_INET6 => {
                    let v6 = self.v6;
                    let (ip, port) = (v6.sin6_addr.s6_addr.into(), u16::from_be(v6.sin6_port));
                    Some(SocketAddrV6::new(ip, port, u32::from_be(v6.sin6_flowinfo), v6.sin6_scope_id).into())
                }
                _ => None,
            }
        }
    }
}
