//! Frames for tests, byte by byte after `docs/wire-format.md`. They do not use `gdp_wire::Header`:
//! a mistake in either becomes visible in the other. [`fixtures`] is the file of forwarding cases
//! that every data plane runs. [`generate`] makes others by the million.
//!
//! This module depends on `gdp-wire`, `serde` and `serde_json` alone: the unit tests of `gdp-wire`
//! include it by path.
#![allow(dead_code, reason = "each test that includes this uses a part of it")]

pub mod carrier;
pub mod fixtures;
pub mod generate;

use carrier::Carrier;
use gdp_wire::siphash::siphash24;

/// An Ethernet frame with a GDP data frame, directly or in the encapsulation of `carrier`. Start
/// from `Frame::default()` and name what differs.
#[derive(Clone, Debug)]
pub struct Frame {
    pub to_mac: [u8; 6],
    pub from_mac: [u8; 6],
    /// The ethertype of GDP frames.
    pub ethertype: u16,
    pub carrier: Carrier,
    pub version_type: u8,
    pub flags: u8,
    pub hop_limit: u8,
    pub egress_set: u8,
    /// The header's payload length; `None`: the length of `payload`.
    pub payload_len: Option<u16>,
    pub header_words: u8,
    pub reserved: u8,
    pub link_id: u32,
    /// The sender's frame counter on the link. The header has its low half; the tag covers all of
    /// it.
    pub link_counter: u64,
    /// The hop tag; `None`: computed with `key`.
    pub tag: Option<u64>,
    pub key: [u64; 2],
    pub egress_bits: u64,
    pub destination: [u8; 32],
    pub source: [u8; 32],
    pub payload: Vec<u8>,
    /// Bytes behind the payload that the header does not count.
    pub padding: usize,
}

impl Default for Frame {
    fn default() -> Self {
        Self {
            to_mac: [0x02, 0, 0, 0, 0, 0xfe],
            from_mac: [0x02, 0, 0, 0, 0, 0x01],
            ethertype: 0x88b5,
            carrier: Carrier::Ethernet,
            version_type: 0x20,
            flags: 0,
            hop_limit: 64,
            egress_set: 0,
            payload_len: None,
            header_words: 12,
            reserved: 0,
            link_id: 0,
            link_counter: 0,
            tag: None,
            key: [0; 2],
            egress_bits: 0,
            destination: [0; 32],
            source: [0; 32],
            payload: b"sealed".to_vec(),
            padding: 0,
        }
    }
}

impl Frame {
    /// Returns the whole Ethernet frame.
    pub fn bytes(&self) -> Vec<u8> {
        self.carrier.carry(self.to_mac, self.from_mac, self.ethertype, &self.carried())
    }

    /// Returns the GDP frame and its padding.
    pub fn carried(&self) -> Vec<u8> {
        let mut bytes = self.header().to_vec();
        bytes.extend(&self.payload);
        bytes.resize(bytes.len() + self.padding, 0);
        bytes
    }

    /// Returns the Ethernet header of a frame directly on Ethernet.
    pub fn ethernet(&self) -> [u8; 14] {
        let bytes = Carrier::Ethernet.carry(self.to_mac, self.from_mac, self.ethertype, &[]);
        bytes.try_into().expect("no more than the header")
    }

    /// Returns the 96 bytes of the GDP header.
    pub fn header(&self) -> [u8; 96] {
        let payload_len = self.payload_len.unwrap_or(self.payload.len() as u16);
        let mut h = [0; 96];
        h[..4].copy_from_slice(&[self.version_type, self.flags, self.hop_limit, self.egress_set]);
        h[4..6].copy_from_slice(&payload_len.to_be_bytes());
        h[6..8].copy_from_slice(&[self.header_words, self.reserved]);
        h[8..12].copy_from_slice(&self.link_id.to_be_bytes());
        h[12..16].copy_from_slice(&(self.link_counter as u32).to_be_bytes());
        h[24..32].copy_from_slice(&self.egress_bits.to_be_bytes());
        h[32..64].copy_from_slice(&self.destination);
        h[64..].copy_from_slice(&self.source);
        let tag = self.tag.unwrap_or_else(|| hop_tag(self.key, self.link_counter, &h));
        h[16..24].copy_from_slice(&tag.to_be_bytes());
        h
    }
}

/// Returns the hop tag: SipHash-2-4 over bytes 0 to 15 and 24 to 63 of the header. The link id is
/// first XORed with the high half of the link counter.
pub fn hop_tag(key: [u64; 2], count: u64, header: &[u8; 96]) -> u64 {
    let mut header = *header;
    for (byte, high) in header[8..12].iter_mut().zip(((count >> 32) as u32).to_be_bytes()) {
        *byte ^= high;
    }
    let word = |i: usize| u64::from_le_bytes(header[i * 8..i * 8 + 8].try_into().expect("eight bytes"));
    let words: [u64; 7] = std::array::from_fn(|i| word(if i < 2 { i } else { i + 1 }));
    siphash24(key, &words)
}
