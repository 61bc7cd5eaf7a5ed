//! One question to the kernel over netlink and its one answer, or one change, for those that cannot
//! wait asynchronously. Whoever wants lists uses `rtnetlink`. Serves [`super::xdp_features`],
//! [`super::device`] and [`super::dpdk`].

use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::sync::atomic::{AtomicU32, Ordering};

/// Of a netlink message, before what its family puts there.
const HEADER: usize = 16;

/// Longest answer read: one interface with all that the kernel says of it.
const LONGEST: usize = 64 * 1024;

/// A socket of the network namespace the calling thread was in when it was opened.
pub struct Netlink(OwnedFd);

impl Netlink {
    /// `family`: `NETLINK_ROUTE`, `NETLINK_GENERIC`.
    pub fn open(family: libc::c_int) -> io::Result<Self> {
        let kind = libc::SOCK_RAW | libc::SOCK_CLOEXEC;
        // SAFETY: a plain system call; the descriptor is owned from here on.
        let fd = unsafe { libc::socket(libc::AF_NETLINK, kind, family) };
        if fd < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: a descriptor just opened, that nobody else has.
        Ok(Self(unsafe { OwnedFd::from_raw_fd(fd) }))
    }

    /// Sends a message of this kind: the family's own header, then attributes. The answer without
    /// the netlink header.
    pub fn ask(&self, kind: u16, family_header: &[u8], attributes: &[(u16, &[u8])]) -> io::Result<Vec<u8>> {
        self.exchange(kind, 0, family_header, attributes)
    }

    /// As [`Self::ask`], of a message that changes something: it is done, or an error.
    #[cfg(feature = "dpdk")]
    pub fn change(&self, kind: u16, family_header: &[u8], attributes: &[(u16, &[u8])]) -> io::Result<()> {
        self.exchange(kind, libc::NLM_F_ACK, family_header, attributes).map(drop)
    }

    fn exchange(
        &self,
        kind: u16,
        flags: libc::c_int,
        family_header: &[u8],
        attributes: &[(u16, &[u8])],
    ) -> io::Result<Vec<u8>> {
        let mut message = Vec::with_capacity(64);
        message.extend(0u32.to_ne_bytes()); // length, below
        message.extend(kind.to_ne_bytes());
        message.extend(((libc::NLM_F_REQUEST | flags) as u16).to_ne_bytes());
        // An answer that nobody waited for is another question's.
        static QUESTIONS: AtomicU32 = AtomicU32::new(0);
        let question = QUESTIONS.fetch_add(1, Ordering::Relaxed).to_ne_bytes();
        message.extend(question);
        message.extend([0; 4]); // port
        message.extend(family_header);
        for (attribute, value) in attributes {
            message.extend((4 + value.len() as u16).to_ne_bytes());
            message.extend(attribute.to_ne_bytes());
            message.extend(*value);
            message.resize(message.len().next_multiple_of(4), 0);
        }
        let length = message.len() as u32;
        message[..4].copy_from_slice(&length.to_ne_bytes());

        // SAFETY: pointer and length are those of `message`.
        let sent = unsafe { libc::send(self.0.as_raw_fd(), message.as_ptr().cast(), message.len(), 0) };
        if sent < 0 {
            return Err(io::Error::last_os_error());
        }
        let mut answer = vec![0; LONGEST];
        loop {
            answer.resize(LONGEST, 0);
            // SAFETY: pointer and length are those of `answer`.
            let received = unsafe { libc::recv(self.0.as_raw_fd(), answer.as_mut_ptr().cast(), answer.len(), 0) };
            answer.truncate(usize::try_from(received).map_err(|_| io::Error::last_os_error())?);
            if answer.get(8..12).is_none_or(|answered| answered == question) {
                break;
            }
        }

        let kind = answer.get(4..6).map(|b| u16::from_ne_bytes([b[0], b[1]]));
        if kind == Some(libc::NLMSG_ERROR as u16) {
            let code = answer.get(16..20).and_then(|b| Some(i32::from_ne_bytes(*b.first_chunk()?))).unwrap_or(0);
            // 0: what was asked for is done, and there is nothing to say.
            return if code == 0 { Ok(Vec::new()) } else { Err(io::Error::from_raw_os_error(-code)) };
        }
        if answer.len() < HEADER { Err(io::ErrorKind::InvalidData.into()) } else { Ok(answer.split_off(HEADER)) }
    }
}

/// The value of the first attribute of this kind.
pub fn attribute(mut attributes: &[u8], kind: u16) -> Option<&[u8]> {
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

/// The number that an attribute of four bytes holds.
pub fn number(attributes: &[u8], kind: u16) -> Option<u32> {
    Some(u32::from_ne_bytes(*attribute(attributes, kind)?.first_chunk()?))
}

#[cfg(test)]
#[path = "../tests/unit/netlink.rs"]
mod tests;
