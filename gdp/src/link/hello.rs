//! The first exchange on a link: what TLS did not say. The side that dialled speaks first; each hello is bounded in size,
//! the whole exchange in time (by the caller).

use gdp_wire::{Header, Name};
use quinn::{Connection, RecvStream, SendStream};
use serde::{Deserialize, Serialize};

use super::ids::{LinkId, LinkIds};
use super::{Link, LinkError, Peer, Place, RekeySchedule, Role, streams, tls};
use crate::control;
use crate::identity::Identity;
use crate::name::NameProof;

const VERSION: u8 = 2;

/// Longest encoded hello, in bytes; a real one has about 100.
const MAX_HELLO: usize = 512;

/// Largest MTU that makes sense: the payload length has 16 bits.
const MAX_MTU: u32 = Header::LEN as u32 + u16::MAX as u32;

/// A link that cannot carry this is of no use.
pub const MIN_MTU: u32 = 512;

#[derive(Debug, Serialize, Deserialize)]
struct Hello {
    version: u8,
    role: Role,
    /// The inner digest of the sender's name.
    #[serde(with = "crate::cbor::array")]
    digest: [u8; 32],
    /// The id frames to the sender must carry.
    link_id: u32,
    /// Largest data frame the sender takes on this link.
    mtu: u32,
    /// Whether the sender takes datagrams over IPv6 without a UDP checksum (RFC 6936).
    zero_checksum: bool,
}

/// What this side says of itself.
#[derive(Clone)]
pub struct HelloConfig {
    pub identity: Identity,
    pub role: Role,
    pub link_ids: LinkIds,
    pub mtu: u32,
    /// See [`Hello`].
    pub zero_checksum: bool,
    /// Not said, but needed for the link that is made.
    pub rekey: RekeySchedule,
}

/// What the peer said of its end of the link.
#[derive(Clone, Copy, Debug)]
pub struct PeerEnd {
    pub id: u32,
    pub mtu: u32,
    pub zero_checksum: bool,
}

/// Says hello on a connection this side dialled; `expected` is who should be there, if that is known.
pub async fn greet_as_client(
    connection: Connection,
    place: Place,
    config: &HelloConfig,
    expected: Option<Name>,
) -> Result<Link, LinkError> {
    let (mut send, mut recv) = connection.open_bi().await?;
    let id = config.link_ids.allocate().ok_or(LinkError::NoFreeId)?;
    say(&mut send, config, &id).await?;
    let (peer, peer_end) = hear(&mut recv, &connection).await?;
    if let Some(expected) = expected
        && expected != peer.name
    {
        connection.close(quinn::VarInt::from_u32(0), b"another peer was expected");
        return Err(LinkError::WrongPeer { expected, found: peer.name });
    }
    Link::new(connection, place, (id, config.mtu), peer, peer_end, true, config.rekey)
}

/// Answers the hello of a connection the peer dialled. Nothing is allocated before the peer has proven and said who it is.
pub async fn greet_as_server(connection: Connection, place: Place, config: &HelloConfig) -> Result<Link, LinkError> {
    let (mut send, mut recv) = connection.accept_bi().await?;
    let (peer, peer_end) = hear(&mut recv, &connection).await?;
    let id = config.link_ids.allocate().ok_or(LinkError::NoFreeId)?;
    say(&mut send, config, &id).await?;
    Link::new(connection, place, (id, config.mtu), peer, peer_end, false, config.rekey)
}

async fn say(send: &mut SendStream, config: &HelloConfig, id: &LinkId) -> Result<(), LinkError> {
    let hello = Hello {
        version: VERSION,
        role: config.role,
        digest: config.identity.proof().digest,
        link_id: id.get(),
        mtu: config.mtu,
        zero_checksum: config.zero_checksum,
    };
    streams::write_message(send, &control::encode(&hello)?).await
}

/// The peer and its end of the link.
async fn hear(recv: &mut RecvStream, connection: &Connection) -> Result<(Peer, PeerEnd), LinkError> {
    let bytes = streams::read_message(recv, MAX_HELLO).await?;
    let hello: Hello = control::decode(&bytes)?;
    if hello.version != VERSION {
        return Err(LinkError::Protocol(format!("it speaks version {}, this side {VERSION}", hello.version)));
    }
    if hello.link_id == 0 {
        return Err(LinkError::Protocol("0 is no link id".into()));
    }
    if !(MIN_MTU..=MAX_MTU).contains(&hello.mtu) {
        return Err(LinkError::Protocol(format!("an MTU of {} bytes, not {MIN_MTU} to {MAX_MTU}", hello.mtu)));
    }
    let key = tls::peer_key(connection)?;
    let proof = NameProof { owner_key: *key.as_bytes(), digest: hello.digest };
    let name = crate::name::derive(&proof.owner_key, &proof.digest);
    let end = PeerEnd { id: hello.link_id, mtu: hello.mtu, zero_checksum: hello.zero_checksum };
    Ok((Peer { name, proof, key, role: hello.role }, end))
}
