//! The host's interface of a port: a TAP interface. Packets that the kernel sends there leave by
//! the port. Packets that arrive at the port and are not for this plane reach the kernel through
//! this interface. Addresses, ARP, routes and sockets therefore work as on any interface.

use std::ffi::{c_char, c_int, c_short};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;

/// A TAP interface in the network namespace of the thread that created it. Dropping it deletes the
/// interface.
pub struct Tap {
    file: File,
    name: String,
}

impl Tap {
    /// Creates the interface. `mtu`: size in bytes of the largest packet without its Ethernet
    /// header.
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
        // SAFETY: the call makes a socket or fails, and no other code owns the descriptor.
        let socket = unsafe {
            let fd = libc::socket(libc::AF_INET, libc::SOCK_DGRAM | libc::SOCK_CLOEXEC, 0);
            if fd < 0 {
                return Err(io::Error::last_os_error());
            }
            <OwnedFd as std::os::fd::FromRawFd>::from_raw_fd(fd)
        };
        let mut request = request(&self.name)?;
        // SAFETY: the structure has only plain bytes, which may all be zero.
        let mut address: libc::sockaddr = unsafe { std::mem::zeroed() };
        address.sa_family = libc::ARPHRD_ETHER;
        address.sa_data.iter_mut().zip(mac).for_each(|(to, byte)| *to = byte as c_char);
        request.ifr_ifru.ifru_hwaddr = address;
        control(socket.as_fd(), libc::SIOCSIFHWADDR, &mut request)?;
        request.ifr_ifru.ifru_mtu = mtu.into();
        control(socket.as_fd(), libc::SIOCSIFMTU, &mut request)?;
        control(socket.as_fd(), libc::SIOCGIFFLAGS, &mut request)?;
        // SAFETY: the kernel has just written this field. The other flags remain: DDS would not use
        // an interface without multicast.
        request.ifr_ifru.ifru_flags = unsafe { request.ifr_ifru.ifru_flags } | libc::IFF_UP as c_short;
        control(socket.as_fd(), libc::SIOCSIFFLAGS, &mut request)
    }

    /// Sets the carrier state that the kernel sees. The interface starts with a carrier.
    pub fn set_carrier(&self, has: bool) -> io::Result<()> {
        let has = c_int::from(has);
        // SAFETY: the operation reads one number of this type.
        let result = unsafe { libc::ioctl(self.file.as_raw_fd(), libc::TUNSETCARRIER, &raw const has) };
        if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
    }

    /// Passes a packet to the kernel; an error if the kernel does not accept it.
    pub fn write(&self, packet: &[u8]) -> io::Result<()> {
        (&self.file).write(packet).map(drop)
    }

    /// Reads a packet that the kernel sends; `None` if there is none now. Bytes beyond the length
    /// of `room` are cut off.
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
    // SAFETY: the structure has only plain bytes, which may all be zero.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    // The name needs a terminating zero byte.
    if name.is_empty() || name.len() >= request.ifr_name.len() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{name:?} is no name of an interface")));
    }
    request.ifr_name.iter_mut().zip(name.bytes()).for_each(|(to, byte)| *to = byte as c_char);
    Ok(request)
}

fn control(fd: BorrowedFd<'_>, operation: libc::Ioctl, request: &mut libc::ifreq) -> io::Result<()> {
    // SAFETY: these operations read and write one structure of this type.
    let result = unsafe { libc::ioctl(fd.as_raw_fd(), operation, std::ptr::from_mut(request)) };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}
