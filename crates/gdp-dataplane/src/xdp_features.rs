//! Queries the XDP features of an interface (generic netlink family `netdev`, Linux 6.3 and later).
//! Frames redirected to an interface that does not accept them are lost. The daemon therefore
//! queries the features before it redirects frames there.

use std::io;

use super::netlink::{Netlink, attribute, number};

const GENL_ID_CTRL: u16 = 0x10;
const CTRL_CMD_GETFAMILY: u8 = 3;
const CTRL_ATTR_FAMILY_ID: u16 = 1;
const CTRL_ATTR_FAMILY_NAME: u16 = 2;
const NETDEV_CMD_DEV_GET: u8 = 1;
const NETDEV_A_DEV_IFINDEX: u16 = 1;
const NETDEV_A_DEV_XDP_FEATURES: u16 = 3;

/// Length of a generic netlink header.
const HEADER: usize = 4;

/// XDP features of an interface (`enum netdev_xdp_act`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Features(pub u64);

impl Features {
    /// Returns whether the interface runs programs natively.
    pub fn native(self) -> bool {
        self.0 & 1 != 0
    }

    /// Returns whether the interface accepts redirected frames. A veth accepts them only while its
    /// peer has GRO on or runs an XDP program.
    pub fn takes_redirects(self) -> bool {
        self.0 & 1 << 2 != 0
    }

    /// Returns whether the interface runs programs on packets in several buffers.
    pub fn several_buffers(self) -> bool {
        self.0 & 1 << 5 != 0
    }
}

/// A query socket in the network namespace of the thread that opened it.
pub struct XdpFeatures {
    netlink: Netlink,
    family: u16,
}

impl XdpFeatures {
    /// Opens the socket.
    ///
    /// # Errors
    /// If the kernel has no such family.
    pub fn open() -> io::Result<Self> {
        let netlink = Netlink::open(libc::NETLINK_GENERIC)?;
        let name = (CTRL_ATTR_FAMILY_NAME, &b"netdev\0"[..]);
        let answer = netlink.ask(GENL_ID_CTRL, &[CTRL_CMD_GETFAMILY, 1, 0, 0], &[name])?;
        let family = answer.get(HEADER..).and_then(|attributes| attribute(attributes, CTRL_ATTR_FAMILY_ID));
        let family = family.and_then(|value| Some(u16::from_ne_bytes(*value.first_chunk()?)));
        Ok(Self { netlink, family: family.ok_or(io::ErrorKind::InvalidData)? })
    }

    pub fn of(&self, ifindex: u32) -> io::Result<Features> {
        let interface = (NETDEV_A_DEV_IFINDEX, &ifindex.to_ne_bytes()[..]);
        let answer = self.netlink.ask(self.family, &[NETDEV_CMD_DEV_GET, 1, 0, 0], &[interface])?;
        let attributes = answer.get(HEADER..).ok_or(io::ErrorKind::InvalidData)?;
        if number(attributes, NETDEV_A_DEV_IFINDEX) != Some(ifindex) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        let features = attribute(attributes, NETDEV_A_DEV_XDP_FEATURES);
        let features = features.and_then(|value| Some(u64::from_ne_bytes(*value.first_chunk()?)));
        Ok(Features(features.ok_or(io::ErrorKind::InvalidData)?))
    }
}
