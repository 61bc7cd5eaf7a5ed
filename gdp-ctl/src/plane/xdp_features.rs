//! Asks the kernel what XDP features an interface has (generic netlink family `netdev`, Linux 6.3 and later). Frames
//! redirected to an interface that does not take them vanish without a trace, so it is asked before any is sent there.

use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

/// Takes frames that other interfaces redirect to it (`NETDEV_XDP_ACT_NDO_XMIT`). A veth has it only while its peer
/// has GRO on or runs an XDP program.
const NDO_XMIT: u64 = 1 << 2;

const GENL_ID_CTRL: u16 = 0x10;
const CTRL_CMD_GETFAMILY: u8 = 3;
const CTRL_ATTR_FAMILY_ID: u16 = 1;
const CTRL_ATTR_FAMILY_NAME: u16 = 2;
const NETDEV_CMD_DEV_GET: u8 = 1;
const NETDEV_A_DEV_IFINDEX: u16 = 1;
const NETDEV_A_DEV_XDP_FEATURES: u16 = 3;

/// The kernel's answers, for the network namespace the calling thread was in when it was opened.
pub struct XdpFeatures {
    socket: OwnedFd,
    family: u16,
}

impl XdpFeatures {
    /// An error on kernels that have no such family.
    pub fn open() -> io::Result<Self> {
        let kind = libc::SOCK_RAW | libc::SOCK_CLOEXEC;
        // SAFETY: a plain system call; the descriptor is owned from here on.
        let fd = unsafe { libc::socket(libc::AF_NETLINK, kind, libc::NETLINK_GENERIC) };
        if fd < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: a descriptor just opened, that nobody else has.
        let socket = unsafe { OwnedFd::from_raw_fd(fd) };
        let answer = ask(&socket, GENL_ID_CTRL, CTRL_CMD_GETFAMILY, CTRL_ATTR_FAMILY_NAME, b"netdev\0")?;
        let family =
            attribute(&answer, CTRL_ATTR_FAMILY_ID).and_then(|value| Some(u16::from_ne_bytes(*value.first_chunk()?)));
        Ok(Self { socket, family: family.ok_or(io::ErrorKind::InvalidData)? })
    }

    /// Whether frames can be redirected to an interface.
    pub fn takes_redirects(&self, ifindex: u32) -> io::Result<bool> {
        let answer = ask(&self.socket, self.family, NETDEV_CMD_DEV_GET, NETDEV_A_DEV_IFINDEX, &ifindex.to_ne_bytes())?;
        let features = attribute(&answer, NETDEV_A_DEV_XDP_FEATURES);
        let features = features.and_then(|value| Some(u64::from_ne_bytes(*value.first_chunk()?)));
        Ok(features.ok_or(io::ErrorKind::InvalidData)? & NDO_XMIT != 0)
    }
}

/// One question with one attribute; the attributes of the answer.
fn ask(socket: &OwnedFd, family: u16, command: u8, attribute: u16, value: &[u8]) -> io::Result<Vec<u8>> {
    let mut message = Vec::with_capacity(64);
    message.extend(0u32.to_ne_bytes()); // length, below
    message.extend(family.to_ne_bytes());
    message.extend((libc::NLM_F_REQUEST as u16).to_ne_bytes());
    message.extend([0; 8]); // sequence and port
    message.extend([command, 1, 0, 0]);
    message.extend((4 + value.len() as u16).to_ne_bytes());
    message.extend(attribute.to_ne_bytes());
    message.extend(value);
    message.resize(message.len().next_multiple_of(4), 0);
    let length = message.len() as u32;
    message[..4].copy_from_slice(&length.to_ne_bytes());

    // SAFETY: pointer and length are those of `message`.
    let sent = unsafe { libc::send(socket.as_raw_fd(), message.as_ptr().cast(), message.len(), 0) };
    if sent < 0 {
        return Err(io::Error::last_os_error());
    }
    let mut answer = vec![0; 8192];
    // SAFETY: pointer and length are those of `answer`.
    let received = unsafe { libc::recv(socket.as_raw_fd(), answer.as_mut_ptr().cast(), answer.len(), 0) };
    answer.truncate(usize::try_from(received).map_err(|_| io::Error::last_os_error())?);

    let kind = answer.get(4..6).map(|b| u16::from_ne_bytes([b[0], b[1]]));
    if kind == Some(libc::NLMSG_ERROR as u16) {
        let code = answer.get(16..20).and_then(|b| Some(i32::from_ne_bytes(*b.first_chunk()?))).unwrap_or(0);
        return Err(io::Error::from_raw_os_error(-code));
    }
    // Behind the netlink header (16) and the generic one (4).
    if answer.len() < 20 { Err(io::ErrorKind::InvalidData.into()) } else { Ok(answer.split_off(20)) }
}

/// The value of the first attribute of this kind.
fn attribute(mut attributes: &[u8], kind: u16) -> Option<&[u8]> {
    loop {
        let header = attributes.first_chunk::<4>()?;
        let length = usize::from(u16::from_ne_bytes([header[0], header[1]]));
        let value = attributes.get(4..length)?;
        // The two highest bits are flags.
        if u16::from_ne_bytes([header[2], header[3]]) & 0x3fff == kind {
            return Some(value);
        }
        attributes = attributes.get(length.next_multiple_of(4)..)?;
    }
}

#[cfg(test)]
mod tests {
    use super::attribute;

    #[test]
    fn attributes_are_found_and_nonsense_is_not_followed() {
        let attributes = [5, 0, 1, 0, 7, 0, 0, 0, 6, 0, 2, 0x80, 1, 2];
        assert_eq!(attribute(&attributes, 1), Some(&[7][..]));
        assert_eq!(attribute(&attributes, 2), Some(&[1, 2][..]));
        assert_eq!(attribute(&attributes, 3), None);
        assert_eq!(attribute(&[0, 0, 1, 0], 2), None, "an attribute without a length");
        assert_eq!(attribute(&[200, 0, 1, 0], 1), None, "longer than the message");
    }
}
