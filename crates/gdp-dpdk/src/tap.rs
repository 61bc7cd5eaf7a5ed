//! The host's side of a port: a TAP interface. What the kernel sends there leaves by the port, and
//! what arrives at the port and is not for this plane comes to the kernel from there, so that
//! addresses, ARP, routes and sockets are as with any interface.

use std::ffi::{c_char, c_int, c_short};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;

/// Made in the network namespace of the calling thread; gone when it is dropped.
pub struct Tap {
    file: File,
    name: String,
}

impl Tap {
    /// `mtu`: bytes of the largest packet behind its Ethernet header.
    pub fn create(name: &str, mac: [u8; 6], mtu: u16) -> io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK).open("/dev/net/tun")?;
        let mut request = request(name)?;
        request.ifr_ifru.ifru_flags = (libc::IFF_TAP | libc::IFF_NO_PI) as c_short;
        control(file.as_fd(), libc::TUNSETIFF, &mut request)?;
        let tap = Self { file, name: name.to_owned() };
        tap.set_up(mac, mtu)?;
        Ok(tap)
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    fn set_up(&self, mac: [u8; 6], mtu: u16) -> io::Result<()> {
        // SAFETY: makes a socket or nothing; the descriptor is nobody else's.
        let socket = unsafe {
            let fd = libc::socket(libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0);
            if fd < 0 {
                return Err(io::Error::last_os_error());
            }
            <OwnedFd as std::os::fd::FromRawFd>::from_raw_fd(fd)
        };
        let mut request = request(&self.name)?;
        // SAFETY: plain bytes, all of which may be zero.
        let mut address: libc::sockaddr = unsafe { std::mem::zeroed() };
        address.sa_family = libc::ARPHRD_ETHER;
        address.sa_data.iter_mut().zip(mac).for_each(|(to, byte)| *to = byte as c_char);
        request.ifr_ifru.ifru_hwaddr = address;
        control(socket.as_fd(), libc::SIOCSIFHWADDR, &mut request)?;
        request.ifr_ifru.ifru_mtu = mtu.into();
        control(socket.as_fd(), libc::SIOCSIFMTU, &mut request)?;
        control(socket.as_fd(), libc::SIOCGIFFLAGS, &mut request)?;
        // SAFETY: what the kernel has just written. The others stay: without multicast DDS would
        // not use it.
        request.ifr_ifru.ifru_flags = unsafe { request.ifr_ifru.ifru_flags } | libc::IFF_UP as c_short;
        control(socket.as_fd(), libc::SIOCSIFFLAGS, &mut request)
    }

    /// Says whether the cable is there, as the kernel is to see it; at first it is.
    pub fn set_carrier(&self, has: bool) -> io::Result<()> {
        let has = c_int::from(has);
        // SAFETY: the operation reads one such number.
        let result = unsafe { libc::ioctl(self.file.as_raw_fd(), libc::TUNSETCARRIER, &raw const has) };
        if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
    }

    /// Gives a packet to the kernel; an error if it does not take it.
    pub fn write(&self, packet: &[u8]) -> io::Result<()> {
        (&self.file).write(packet).map(drop)
    }

    /// A packet that the kernel sends; `None` if there is none now. What does not fit into `room`
    /// is cut off.
    pub fn read(&self, room: &mut [u8]) -> io::Result<Option<usize>> {
        match (&self.file).read(room) {
            Ok(length) => Ok(Some(length)),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error),
        }
    }
}

impl AsFd for Tap {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

fn request(name: &str) -> io::Result<libc::ifreq> {
    // SAFETY: plain bytes, all of which may be zero.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    // With the null byte at its end.
    if name.is_empty() || name.len() >= request.ifr_name.len() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{name:?} is no name of an interface")));
    }
    request.ifr_name.iter_mut().zip(name.bytes()).for_each(|(to, byte)| *to = byte as c_char);
    Ok(request)
}

fn control(fd: BorrowedFd<'_>, operation: libc::Ioctl, request: &mut libc::ifreq) -> io::Result<()> {
    // SAFETY: these operations read and write one such structure.
    let result = unsafe { libc::ioctl(fd.as_raw_fd(), operation, std::ptr::from_mut(request)) };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}
