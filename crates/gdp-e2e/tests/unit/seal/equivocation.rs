//! A malicious writer against its own readers. It gives two readers different keys of one epoch,
//! and makes one ciphertext that opens under both, to different messages. AES-GCM does not prevent
//! that: a tag is linear in the ciphertext, so one free block makes two tags equal. The signature
//! must: it covers the plaintext, and commits to the key.

use super::tests::{EPOCH, Fixture, at};
use super::wire::{self, HEADER_LEN, Kind, Proof, SegmentHeader};
use super::*;
use gdp_core::crypto::{self, Aead, Backend, TAG_LEN};
use gdp_core::keys::{EpochKey, SessionKey};

const SESSION: [u8; 16] = [5; 16];
const BLOCK: usize = 16;
/// The length of the header before a message's extensions and body.
const PREAMBLE: usize = 12;
/// A type of extensions that readers skip.
const UNKNOWN_EXTENSION: u16 = 0x7fff;

#[test]
fn a_writer_cannot_tell_two_readers_different_things_under_one_signature() {
    let f = Fixture::new();
    let forgery = Forgery::new(&f);
    // What each reader believes, if the signature is for this one's key and that one's message.
    let told = |key: usize, message: usize| {
        let frames = forgery.frames(&f, key, message);
        forgery.keys.each_ref().map(|key| {
            let mut reader = Reader::new(f.name, f.reading, f.limits);
            reader.authorise(f.writer_name(), f.entity.key().verify_key()).unwrap();
            reader.set_key(&f.writer_name(), EPOCH, key.clone()).unwrap();
            reader.confirm_session(&f.writer_name(), SESSION, 0).unwrap();
            let mut out = Received::default();
            for frame in &frames {
                // The proof is sealed once for each reader. The other one does not open.
                let _ = reader.push(at(0), f.writer_name(), frame, &mut out);
            }
            out.messages.pop().map(|message| message.body.to_vec())
        })
    };
    // The one ciphertext opens for both: each believes it below a signature for it.
    let ([forward, nothing], [neither, backward]) = (told(0, 0), told(1, 1));
    assert!(forward.unwrap()[4..].starts_with(b"forward"));
    assert!(backward.unwrap().starts_with(b"backward"));
    // But below no signature both do.
    assert_eq!([nothing, neither], [None, None]);
    assert_eq!([told(0, 1), told(1, 0)], [[None, None], [None, None]]);
}

/// One body segment that opens under two keys.
struct Forgery {
    keys: [EpochKey; 2],
    session_keys: [SessionKey; 2],
    header: SegmentHeader,
    /// Ciphertext and tag.
    sealed: Vec<u8>,
}

impl Forgery {
    fn new(f: &Fixture) -> Self {
        let (keys, extensions) = similar_keys(f);
        let session_keys = keys.clone().map(|key| session_key(f, &key));
        let len = (PREAMBLE + extensions + 64).next_multiple_of(BLOCK);
        let header = SegmentHeader { sealed_len: (len + TAG_LEN) as u16, size: len as u32, ..HEADER };
        let streams = session_keys.each_ref().map(|key| keystream(&key.aead, &header, len));

        // The first reader sees no extensions. The second one skips an extension up to its body.
        let mut sealed = vec![0; len];
        let mut put = |from: usize, text: &[u8], reader: usize| {
            let sealed = &mut sealed[from..from + text.len()];
            sealed.copy_from_slice(&xor(text, &streams[reader][from..]));
        };
        put(0, &[0; PREAMBLE], 0);
        let length = (extensions - 4) as u16;
        put(PREAMBLE, &[UNKNOWN_EXTENSION.to_be_bytes(), length.to_be_bytes()].concat(), 1);
        put(PREAMBLE + 4, b"forward", 0);
        put(PREAMBLE + extensions, b"backward", 1);

        let clear = header.to_bytes();
        let [(h1, mask1), (h2, mask2)] = session_keys.each_ref().map(|key| hash_key(&key.aead, &header));
        let differ = ghash(h1, &clear, &sealed) ^ ghash(h2, &clear, &sealed) ^ mask1 ^ mask2;
        // The last block is free. Behind it, only the lengths are hashed.
        let factor = power(h1, 2) ^ power(h2, 2);
        sealed[len - BLOCK..].copy_from_slice(&multiply(differ, inverse(factor)).to_be_bytes());
        let tag = ghash(h1, &clear, &sealed) ^ mask1;
        sealed.extend(tag.to_be_bytes());
        Self { keys, session_keys, header, sealed }
    }

    /// Returns the body segment, and the proof sealed for each reader. The signature is for the key
    /// of one reader, and the message that one sees.
    fn frames(&self, f: &Fixture, key: usize, message: usize) -> Vec<Vec<u8>> {
        let ciphertext = &self.sealed[..self.sealed.len() - TAG_LEN];
        let plaintext = xor(ciphertext, &keystream(&self.session_keys[message].aead, &self.header, ciphertext.len()));
        let digests = [&plaintext[..], b""].map(|part| crypto::sha256(&[part]));
        let (commitment, place) = (&self.session_keys[key].commitment, (&f.name, &f.writer_name()));
        let root = wire::leaf(commitment, place, &self.header, &digests);
        let signature = f.entity.key().sign(&wire::batch_statement(&root)).unwrap();
        let len = wire::proof_len(0);
        let header = SegmentHeader { kind: Kind::Last, index: 1, sealed_len: (len + TAG_LEN) as u16, ..self.header };
        let proofs = self.session_keys.iter().map(|key| {
            let (clear, mut sealed) = (header.to_bytes(), vec![0; len]);
            Proof { position: 0, path: &[], signature: &signature }.write(&mut sealed);
            let tag = key.aead.seal(&header.nonce(), &clear, &mut sealed).unwrap();
            [&clear[..], &sealed, &tag].concat()
        });
        std::iter::once([&self.header.to_bytes()[..], &self.sealed].concat()).chain(proofs).collect()
    }
}

const HEADER: SegmentHeader = SegmentHeader {
    kind: Kind::Body,
    sealed_len: 0,
    index: 0,
    sequence: 1,
    cut: 0,
    session: SESSION,
    count: 2,
    size: 0,
    epoch: EPOCH,
};

/// Searches two keys, so that the second reader sees extensions of a few bytes where the first one
/// sees none. Returns them and that length.
fn similar_keys(f: &Fixture) -> ([EpochKey; 2], usize) {
    let length = |number| {
        let stream = keystream(&session_key(f, &numbered(number)).aead, &HEADER, PREAMBLE);
        u16::from_be_bytes([stream[10], stream[11]])
    };
    let first = length(0);
    let extensions = |number| usize::from(length(number) ^ first);
    let second = (1..).find(|number| (24..1000).contains(&extensions(*number))).unwrap();
    ([0, second].map(numbered), extensions(second))
}

fn numbered(number: u32) -> EpochKey {
    let mut key = [0; 32];
    key[..4].copy_from_slice(&number.to_be_bytes());
    EpochKey::from_bytes(key)
}

fn session_key(f: &Fixture, key: &EpochKey) -> SessionKey {
    key.session_key(Backend::selected(), &f.name, &f.writer_name(), &SESSION).unwrap()
}

fn keystream(aead: &Aead, header: &SegmentHeader, len: usize) -> Vec<u8> {
    let mut stream = vec![0; len];
    aead.seal(&header.nonce(), &[], &mut stream).unwrap();
    stream
}

/// Returns the key of GHASH, and the block that masks the tag of this nonce. Both follow from tags.
fn hash_key(aead: &Aead, header: &SegmentHeader) -> (u128, u128) {
    let tag = |aad: &[u8]| u128::from_be_bytes(aead.seal(&header.nonce(), aad, &mut []).unwrap());
    let square = tag(&[0; BLOCK]) ^ tag(&ONE.to_be_bytes());
    // Squaring 127 more times is squaring 128 times in all, which changes nothing.
    let key = (0..127).fold(square, |value, _| multiply(value, value));
    (key, tag(&[]))
}

/// The element 1 of GCM's field: bits count from the highest.
const ONE: u128 = 1 << 127;

/// GHASH (NIST SP 800-38D §6.4) of additional data and ciphertext.
fn ghash(key: u128, clear: &[u8; HEADER_LEN], ciphertext: &[u8]) -> u128 {
    let block = |bytes: &[u8]| {
        let mut block = [0; BLOCK];
        block[..bytes.len()].copy_from_slice(bytes);
        u128::from_be_bytes(block)
    };
    let lengths = ((clear.len() as u128 * 8) << 64) | (ciphertext.len() as u128 * 8);
    let blocks = clear.chunks(BLOCK).chain(ciphertext.chunks(BLOCK)).map(block).chain([lengths]);
    blocks.fold(0, |hash, block| multiply(hash ^ block, key))
}

fn multiply(a: u128, b: u128) -> u128 {
    let (mut product, mut shifted) = (0, b);
    for bit in (0..128).rev() {
        if a >> bit & 1 == 1 {
            product ^= shifted;
        }
        shifted = shifted >> 1 ^ if shifted & 1 == 1 { 0xe1 << 120 } else { 0 };
    }
    product
}

fn power(a: u128, exponent: u128) -> u128 {
    (0..128).rev().fold(ONE, |value, bit| {
        let square = multiply(value, value);
        if exponent >> bit & 1 == 1 { multiply(square, a) } else { square }
    })
}

fn inverse(a: u128) -> u128 {
    power(a, u128::MAX - 1)
}

fn xor(text: &[u8], stream: &[u8]) -> Vec<u8> {
    text.iter().zip(stream).map(|(text, stream)| text ^ stream).collect()
}
