//! The few system calls of ports that the standard library lacks, each wrapped once.

use std::io;
use std::mem::{size_of, size_of_val, zeroed};
use std::net::{SocketAddr, SocketAddrV4, SocketAddrV6, UdpSocket};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::time::Duration;

/// Has a socket send and receive through one interface only.
pub fn bind_to_interface(fd: BorrowedFd, interface: &str) -> io::Result<()> {
    // The kernel takes names of up to so many bytes, with the zero that ends them.
    let mut name = [0u8; libc::IFNAMSIZ];
    let long = || io::Error::new(io::ErrorKind::InvalidInput, "the name of the interface is too long");
    name[..libc::IFNAMSIZ - 1].get_mut(..interface.len()).ok_or_else(long)?.copy_from_slice(interface.as_bytes());
    set_option(fd, libc::SOL_SOCKET, libc::SO_BINDTODEVICE, &name)
}

/// A UDP socket, non-blocking, at an address that another has and shares, bound to the same
/// interface.
pub fn bind_shared_udp(addr: SocketAddr, interface: Option<&str>) -> io::Result<UdpSocket> {
    let family = if addr.is_ipv6() { libc::AF_INET6 } else { libc::AF_INET };
    // SAFETY: no pointers; the descriptor is owned from here on.
    let socket = unsafe {
        let flags = libc::SOCK_DGRAM | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
        OwnedFd::from_raw_fd(check(libc::socket(family, flags, 0))?)
    };
    set_option(socket.as_fd(), libc::SOL_SOCKET, libc::SO_REUSEPORT, &1i32)?;
    if let Some(interface) = interface {
        bind_to_interface(socket.as_fd(), interface)?;
    }
    let (raw, length) = RawAddr::socket(addr, addr.is_ipv6());
    // SAFETY: an address of the length given.
    check(unsafe { libc::bind(socket.as_raw_fd(), (&raw const raw).cast(), length) })?;
    Ok(socket.into())
}

/// Turns the usual −1 into the error it stands for.
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

/// `T`: an integer of the size that the option has.
pub fn get_option<T: Copy + Default>(fd: BorrowedFd, level: libc::c_int, option: libc::c_int) -> io::Result<T> {
    let mut value = T::default();
    let mut length = size_of::<T>() as u32;
    // SAFETY: the kernel writes at most `length` bytes into `value`; the callers' types are
    // integers, which any bytes are.
    check(unsafe { libc::getsockopt(fd.as_raw_fd(), level, option, (&raw mut value).cast(), &raw mut length) })?;
    Ok(value)
}

/// Asks for socket buffers of `bytes`: beyond the system's limit with CAP_NET_ADMIN, else up to the
/// limit.
pub fn set_buffers(fd: BorrowedFd, receive: usize, send: usize) {
    for (bytes, force, polite) in
        [(receive, libc::SO_RCVBUFFORCE, libc::SO_RCVBUF), (send, libc::SO_SNDBUFFORCE, libc::SO_SNDBUF)]
    {
        let bytes = bytes as libc::c_int;
        if set_option(fd, libc::SOL_SOCKET, force, &bytes).is_err() {
            // A smaller buffer than wished for is no error: it shows in the drop counters.
            let _ = set_option(fd, libc::SOL_SOCKET, polite, &bytes);
        }
    }
}

/// Frames the kernel dropped because the receive buffer of the socket was full, since it was
/// opened.
pub fn receive_drops(fd: BorrowedFd) -> u64 {
    const SK_MEMINFO_DROPS: usize = 8;
    memory(fd)[SK_MEMINFO_DROPS].into()
}

/// Bytes of memory that hold what the socket has sent and no interface has taken yet.
pub fn send_queue(fd: BorrowedFd) -> usize {
    const SK_MEMINFO_WMEM_ALLOC: usize = 2;
    memory(fd)[SK_MEMINFO_WMEM_ALLOC] as usize
}

/// What the kernel says of a socket's memory (linux/sock_diag.h).
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

/// Receives what is there, one datagram or frame for each of the messages; how many there were.
///
/// # Safety
///
/// What the messages point to must be as long as they say, and nobody else's until this returns.
pub unsafe fn receive(fd: BorrowedFd, messages: &mut [libc::mmsghdr]) -> io::Result<usize> {
    let (count, flags, no_timeout) = (messages.len() as u32, libc::MSG_DONTWAIT, std::ptr::null_mut());
    loop {
        // SAFETY: the caller's promise.
        let result = unsafe { libc::recvmmsg(fd.as_raw_fd(), messages.as_mut_ptr(), count, flags as _, no_timeout) };
        let Err(error) = check(result) else { return Ok(result as usize) };
        match error.raw_os_error() {
            Some(libc::EINTR) => {}
            // ENETDOWN is told once after the interface went down; it may come up again.
            Some(libc::EAGAIN | libc::ENETDOWN) => return Ok(0),
            _ => return Err(error),
        }
    }
}

/// Attaches a classic BPF program: a filter (`SO_ATTACH_FILTER`), or what chooses among sockets of
/// one port (`SO_ATTACH_REUSEPORT_CBPF`).
pub fn attach_program(fd: BorrowedFd, option: libc::c_int, program: &mut [libc::sock_filter]) -> io::Result<()> {
    let program = libc::sock_fprog { len: program.len() as u16, filter: program.as_mut_ptr() };
    set_option(fd, libc::SOL_SOCKET, option, &program)
}

/// An instruction of classic BPF.
pub const fn step(code: u32, jump_true: u8, jump_false: u8, k: u32) -> libc::sock_filter {
    libc::sock_filter { code: code as u16, jt: jump_true, jf: jump_false, k }
}

/// Waits until the descriptor is ready for `events` (POLLIN, POLLOUT), `wake` is set, or the time
/// is over; tells whether the descriptor is ready. Clears `wake`.
pub fn wait(fd: BorrowedFd, events: i16, wake: Option<&WakeFd>, timeout: Duration) -> io::Result<bool> {
    let poll = |fd: BorrowedFd, events| libc::pollfd { fd: fd.as_raw_fd(), events, revents: 0 };
    let mut polls = [poll(fd, events), poll(wake.map_or(fd, WakeFd::fd), libc::POLLIN)];
    let count = if wake.is_some() { 2 } else { 1 };
    let time = libc::timespec {
        tv_sec: timeout.as_secs().min(i32::MAX as u64) as libc::time_t,
        tv_nsec: timeout.subsec_nanos().into(),
    };
    // SAFETY: `count` of two pollfds and one timespec, all alive during the call; no signal mask.
    match check(unsafe { libc::ppoll(polls.as_mut_ptr(), count, &time, std::ptr::null()) }) {
        Ok(_) => {
            if let Some(wake) = wake.filter(|_| polls[1].revents != 0) {
                wake.clear();
            }
            Ok(polls[0].revents != 0)
        }
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(false),
        Err(error) => Err(error),
    }
}

/// Waits until one of the descriptors can be read, one of the events is set, or the time is over.
/// Clears the events.
pub fn wait_any(all: &[(BorrowedFd, &WakeFd)], timeout: Duration) -> io::Result<()> {
    let poll = |fd: BorrowedFd| libc::pollfd { fd: fd.as_raw_fd(), events: libc::POLLIN, revents: 0 };
    let mut polls: Vec<_> = all.iter().flat_map(|(fd, wake)| [poll(*fd), poll(wake.fd())]).collect();
    let time = libc::timespec {
        tv_sec: timeout.as_secs().min(i32::MAX as u64) as libc::time_t,
        tv_nsec: timeout.subsec_nanos().into(),
    };
    // SAFETY: so many pollfds and one timespec, all alive during the call; no signal mask.
    match check(unsafe { libc::ppoll(polls.as_mut_ptr(), polls.len() as libc::nfds_t, &time, std::ptr::null()) }) {
        Ok(_) => {
            let woken = all.iter().zip(polls.chunks(2)).filter(|(_, polls)| polls[1].revents != 0);
            woken.for_each(|((_, wake), _)| wake.clear());
            Ok(())
        }
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(()),
        Err(error) => Err(error),
    }
}

/// An eventfd: lets a queue in memory be waited for like a socket.
#[derive(Debug)]
pub struct WakeFd(OwnedFd);

impl WakeFd {
    pub fn new() -> io::Result<Self> {
        // SAFETY: no pointers; the descriptor is owned from here on.
        Ok(Self(unsafe { OwnedFd::from_raw_fd(check(libc::eventfd(0, libc::EFD_NONBLOCK | libc::EFD_CLOEXEC))?) }))
    }

    pub fn set(&self) {
        let one = 1u64;
        // SAFETY: eight bytes are read from `one`. It can only fail when the event is set already
        // 2^64 − 2 times.
        unsafe { libc::write(self.0.as_raw_fd(), (&raw const one).cast(), size_of::<u64>()) };
    }

    pub fn clear(&self) {
        let mut count = 0u64;
        // SAFETY: eight bytes are written to `count`. It only fails when the event is not set.
        unsafe { libc::read(self.0.as_raw_fd(), (&raw mut count).cast(), size_of::<u64>()) };
    }

    pub fn fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

/// A socket address in the kernel's form, for the calls of the `mmsg` family.
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

    /// The address of a station on the segment of an interface.
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

    /// The MAC address of a sender, from an address a packet socket wrote.
    pub fn mac(&self) -> [u8; 6] {
        // SAFETY: plain integers, whatever was written.
        let address = unsafe { self.link.sll_addr };
        [address[0], address[1], address[2], address[3], address[4], address[5]]
    }

    /// An IP address, in the form for a socket of the given family (an IPv6 socket takes IPv4
    /// mapped); and its length.
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
    /// The sender, from an address an IP socket wrote.
    pub fn socket_addr(&self) -> Option<SocketAddr> {
        // SAFETY: all three variants begin with the family, and are plain integers, whatever was
        // written.
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
