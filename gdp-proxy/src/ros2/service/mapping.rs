//! The two mappings of request identity in DDS services: how a reply identifies its request.

use bytes::{BufMut, Bytes, BytesMut};
use rustdds::rpc::SampleIdentity;
use rustdds::{GUID, SequenceNumber};

use super::super::raw_reader::SampleChange;
use super::super::sample::{ENCAPSULATION, RawSample, Representation};

/// The place of the request's identity in the messages of a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mapping {
    /// In the sample's metadata, as rmw_fastrtps does ("enhanced", DDS-RPC 1.0 §7.8.2). The body is
    /// that of ROS alone.
    Enhanced,
    /// In a header of 16 bytes before the body, as rmw_cyclonedds does: the client's number and a
    /// sequence number.
    Cyclone,
}

impl Mapping {
    /// Returns the mapping of an endpoint, from the vendor ID at the start of its GUID (RTPS 2.5
    /// §9.3.1.1).
    pub fn of(endpoint: [u8; 16]) -> Self {
        match endpoint {
            [1, 0x10, ..] => Self::Cyclone,
            _ => Self::Enhanced,
        }
    }
}

/// The identity of the request that a reply answers. It is opaque and only valid at the server that
/// returned it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct RequestId(pub(super) Id);

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Id {
    Sample(SampleIdentity),
    /// Two words of eight bytes, little-endian whatever the encoding of the message.
    Header([u8; HEADER]),
}

pub(super) const HEADER: usize = 16;

/// A service message that is too short for the header of its mapping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a service message has no request header: is its vendor's mapping another than {0:?}?")]
pub struct Headless(Mapping);

/// Splits a request into its identity, with which the server replies, and its body.
pub(super) fn request(change: SampleChange, mapping: Mapping) -> Result<(RequestId, RawSample), Headless> {
    match mapping {
        Mapping::Cyclone => behead(change.sample),
        Mapping::Enhanced => {
            // rmw_fastrtps announces its reader of replies here, so that servers can check whether
            // that reader is matched yet.
            let asker = change.related.map(|related| related.writer_guid).filter(|guid| *guid != GUID::GUID_UNKNOWN);
            let writer_guid = asker.unwrap_or(change.writer);
            let id = SampleIdentity { writer_guid, sequence_number: change.sequence };
            Ok((RequestId(Id::Sample(id)), change.sample))
        }
    }
}

/// Splits a reply into the identity of its request and its body. Returns `None` if it has no
/// identity.
pub(super) fn reply(change: SampleChange, mapping: Mapping) -> Result<Option<(RequestId, RawSample)>, Headless> {
    match mapping {
        Mapping::Cyclone => behead(change.sample).map(Some),
        Mapping::Enhanced => Ok(change.related.map(|id| (RequestId(Id::Sample(id)), change.sample))),
    }
}

/// Returns the header of the `number`-th request of a client.
pub(super) fn header(client: GUID, number: u64) -> [u8; HEADER] {
    let mut header = [0; HEADER];
    // As rmw_cyclonedds: the half of the GUID that differs between the clients of a process.
    header[..8].copy_from_slice(&client.to_bytes()[8..]);
    header[8..].copy_from_slice(&number.to_le_bytes());
    header
}

fn behead(sample: RawSample) -> Result<(RequestId, RawSample), Headless> {
    let (RawSample { representation, bytes }, short) = (sample, Headless(Mapping::Cyclone));
    let header = bytes.get(ENCAPSULATION..ENCAPSULATION + HEADER).ok_or(short)?;
    let mut words: [u8; HEADER] = header.try_into().map_err(|_| short)?;
    orient(&mut words, representation);
    // The header has twice the largest alignment of XCDR1, so the body keeps its alignment without
    // it.
    let mut body = BytesMut::with_capacity(bytes.len() - HEADER);
    body.put_slice(&bytes[..ENCAPSULATION]);
    body.put_slice(&bytes[ENCAPSULATION + HEADER..]);
    Ok((RequestId(Id::Header(words)), RawSample { representation, bytes: body.freeze() }))
}

pub(super) fn with_header(sample: &RawSample, mut header: [u8; HEADER]) -> RawSample {
    orient(&mut header, sample.representation);
    let (encapsulation, body) = sample.bytes.split_at(ENCAPSULATION);
    let bytes: Bytes = [encapsulation, &header, body].concat().into();
    RawSample { representation: sample.representation, bytes }
}

fn orient(header: &mut [u8; HEADER], representation: Representation) {
    if representation == Representation::CdrBe {
        let (client, sequence) = header.split_at_mut(8);
        client.reverse();
        sequence.reverse();
    }
}

/// Returns the identity of the client in a request of rmw_fastrtps's mapping.
pub(super) fn asker(replies: GUID) -> SampleIdentity {
    SampleIdentity { writer_guid: replies, sequence_number: SequenceNumber::UNKNOWN }
}

#[cfg(test)]
#[path = "../../../tests/unit/ros2/service/mapping.rs"]
mod tests;
