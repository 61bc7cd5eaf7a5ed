//! One netlink request to the kernel and its reply, for callers that cannot be async. Callers that
//! need lists use `rtnetlink`, which builds on the same crates. [`super::xdp_features`],
//! [`super::device`] and [`super::dpdk`] use this module.

use std::convert::Infallible;
use std::io;
use std::sync::atomic::{AtomicU32, Ordering};

use netlink_packet_core::{
    DefaultNla, Emitable, NLA_HEADER_SIZE, NLM_F_REQUEST, NetlinkDeserializable, NetlinkHeader, NetlinkMessage,
    NetlinkPayload, NetlinkSerializable, NlasIterator,
};
use netlink_sys::Socket;

/// Maximum length of a reply: one interface with all its attributes.
const LONGEST: usize = 64 * 1024;

/// A socket in the network namespace of the thread that opened it.
pub struct Netlink(Socket);

/// A message of any family: the family's own header, then attributes.
struct Message {
    kind: u16,
    body: Vec<u8>,
}

impl Netlink {
    /// Opens a socket. `family`: `NETLINK_ROUTE`, `NETLINK_GENERIC`.
    pub fn open(family: libc::c_int) -> io::Result<Self> {
        Socket::new(family as isize).map(Self)
    }

    /// Sends a message of this kind, with the family's own header and attributes. Returns the reply
    /// without the netlink header.
    pub fn ask(&self, kind: u16, family_header: &[u8], attributes: &[(u16, &[u8])]) -> io::Result<Vec<u8>> {
        self.exchange(kind, 0, family_header, attributes)
    }

    /// Sends a message that changes something, as [`Self::ask`] does. Returns when the kernel
    /// acknowledges it, or the kernel's error.
    #[cfg(feature = "dpdk")]
    pub fn change(&self, kind: u16, family_header: &[u8], attributes: &[(u16, &[u8])]) -> io::Result<()> {
        self.exchange(kind, netlink_packet_core::NLM_F_ACK, family_header, attributes).map(drop)
    }

    fn exchange(
        &self,
        kind: u16,
        flags: u16,
        family_header: &[u8],
        attributes: &[(u16, &[u8])],
    ) -> io::Result<Vec<u8>> {
        static SEQUENCE: AtomicU32 = AtomicU32::new(0);
        let sequence = SEQUENCE.fetch_add(1, Ordering::Relaxed);
        let mut header = NetlinkHeader::default();
        (header.flags, header.sequence_number) = (NLM_F_REQUEST | flags, sequence);
        let message = Message::new(kind, family_header, attributes);
        let mut request = NetlinkMessage::new(header, NetlinkPayload::InnerMessage(message));
        request.finalize();
        let mut bytes = vec![0; request.buffer_len()];
        request.serialize(&mut bytes);
        self.0.send(&bytes, 0)?;
        loop {
            let mut reply = Vec::with_capacity(LONGEST);
            self.0.recv(&mut reply, 0)?;
            let reply = NetlinkMessage::<Message>::deserialize(&reply)
                .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error))?;
            // Skip replies to earlier requests whose caller stopped waiting.
            if reply.header.sequence_number != sequence {
                continue;
            }
            return match reply.payload {
                NetlinkPayload::InnerMessage(message) => Ok(message.body),
                // An acknowledgement without data.
                NetlinkPayload::Error(error) if error.code.is_none() => Ok(Vec::new()),
                NetlinkPayload::Error(error) => Err(error.to_io()),
                _ => Err(io::ErrorKind::InvalidData.into()),
            };
        }
    }
}

impl Message {
    fn new(kind: u16, family_header: &[u8], attributes: &[(u16, &[u8])]) -> Self {
        let attributes: Vec<_> =
            attributes.iter().map(|(kind, value)| DefaultNla::new(*kind, value.to_vec())).collect();
        let mut body = family_header.to_vec();
        body.resize(family_header.len() + attributes.as_slice().buffer_len(), 0);
        attributes.as_slice().emit(&mut body[family_header.len()..]);
        Self { kind, body }
    }
}

impl NetlinkSerializable for Message {
    fn message_type(&self) -> u16 {
        self.kind
    }

    fn buffer_len(&self) -> usize {
        self.body.len()
    }

    fn serialize(&self, buffer: &mut [u8]) {
        buffer.copy_from_slice(&self.body);
    }
}

impl NetlinkDeserializable for Message {
    type Error = Infallible;

    fn deserialize(header: &NetlinkHeader, body: &[u8]) -> Result<Self, Infallible> {
        Ok(Self { kind: header.message_type, body: body.to_vec() })
    }
}

/// Returns the value of the first attribute of this kind.
pub fn attribute(attributes: &[u8], kind: u16) -> Option<&[u8]> {
    let mut all = NlasIterator::new(attributes).map_while(Result::ok);
    let found = all.find(|attribute| attribute.kind() == kind)?;
    let length = usize::from(found.length());
    found.into_inner().get(NLA_HEADER_SIZE..length)
}

/// Returns the value of a four-byte attribute.
pub fn number(attributes: &[u8], kind: u16) -> Option<u32> {
    Some(u32::from_ne_bytes(*attribute(attributes, kind)?.first_chunk()?))
}

#[cfg(test)]
#[path = "../tests/unit/netlink.rs"]
mod tests;
