//! Heartbeats: a writer's signed statement about the progress of its session. Only encoding.

use super::wire::{HEARTBEAT_CLAIMS, HEARTBEAT_CUT, HEARTBEAT_LEN, Kind, SegmentHeader};
use gdp_core::crypto::{SIGNATURE_LEN, TAG_LEN};
use gdp_core::name::Name;

const HEARTBEAT_CONTEXT: &[u8] = b"gdp/heartbeat/1";

impl SegmentHeader {
    /// Returns the header of the `number`th heartbeat of a session.
    pub fn heartbeat(session: [u8; 16], number: u32, next: u64, epoch: u32) -> Self {
        Self {
            kind: Kind::Heartbeat,
            sealed_len: (HEARTBEAT_LEN + TAG_LEN) as u16,
            index: number,
            sequence: next,
            cut: HEARTBEAT_CUT,
            session,
            count: 0,
            size: 0,
            epoch,
        }
    }
}

const HEARTBEAT_STATEMENT: usize = HEARTBEAT_CONTEXT.len() + 64 + 28 + HEARTBEAT_CLAIMS;

/// The contents of a heartbeat in addition to its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeartbeatBody {
    pub timestamp_ns: u64,
    /// The sequence of the oldest message that the writer can repeat.
    pub oldest: u64,
}

impl HeartbeatBody {
    /// Returns the plaintext. `signature` is that of the [statement](Self::statement).
    pub fn to_bytes(self, signature: &[u8; SIGNATURE_LEN]) -> [u8; HEARTBEAT_LEN] {
        let mut bytes = [0u8; HEARTBEAT_LEN];
        bytes[..HEARTBEAT_CLAIMS].copy_from_slice(&self.claims());
        bytes[HEARTBEAT_CLAIMS..].copy_from_slice(signature);
        bytes
    }

    pub fn parse(plaintext: &[u8]) -> Option<(Self, &[u8; SIGNATURE_LEN])> {
        let (&[t0, t1, t2, t3, t4, t5, t6, t7, o0, o1, o2, o3, o4, o5, o6, o7], signature) =
            plaintext.split_first_chunk::<HEARTBEAT_CLAIMS>()?;
        let timestamp_ns = u64::from_be_bytes([t0, t1, t2, t3, t4, t5, t6, t7]);
        let oldest = u64::from_be_bytes([o0, o1, o2, o3, o4, o5, o6, o7]);
        Some((Self { timestamp_ns, oldest }, signature.try_into().ok()?))
    }

    /// Returns the statement that the writer signs.
    pub fn statement(&self, name: &Name, writer: &Name, header: &SegmentHeader) -> [u8; HEARTBEAT_STATEMENT] {
        let mut statement = [0u8; HEARTBEAT_STATEMENT];
        let mut rest = &mut statement[..];
        // Number, next sequence and session from the header.
        let parts: [&[u8]; 5] =
            [HEARTBEAT_CONTEXT, name.as_bytes(), writer.as_bytes(), &header.to_bytes()[4..32], &self.claims()];
        for part in parts {
            let (place, behind) = rest.split_at_mut(part.len());
            place.copy_from_slice(part);
            rest = behind;
        }
        statement
    }

    fn claims(&self) -> [u8; HEARTBEAT_CLAIMS] {
        let mut claims = [0u8; HEARTBEAT_CLAIMS];
        claims[..8].copy_from_slice(&self.timestamp_ns.to_be_bytes());
        claims[8..].copy_from_slice(&self.oldest.to_be_bytes());
        claims
    }
}
