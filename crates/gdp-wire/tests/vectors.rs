//! `docs/vectors/header.json`: headers field by field and byte by byte, for other implementations.
//! This test checks them against [`Header`] and [`forward::accept`]. `GDP_BLESS=1 cargo test -p
//! gdp-wire` writes the file with the frame builder of the tests, which does not use [`Header`].

#[path = "../../../tests/src/frames/mod.rs"]
mod frames;

use frames::Frame;
use frames::fixtures::{array, hex, key, unhex};
use gdp_wire::{ControlHeader, Counter, FrameType, Header, LinkEntry, Name, forward, hop, replay};
use serde::{Deserialize, Serialize};
use zerocopy::{FromBytes, IntoBytes};

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/vectors/header.json");

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Vectors {
    about: Vec<String>,
    data: Vec<Data>,
    control: Vec<Control>,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Data {
    /// The link's SipHash key for this direction, 16 bytes.
    key: String,
    flags: u8,
    hop_limit: u8,
    egress_set: u8,
    payload_length: u16,
    reserved: u8,
    link_id: u32,
    link_counter: u32,
    /// As on the wire.
    tag: String,
    egress_bits: String,
    destination: String,
    source: String,
    header: String,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Control {
    kind: u8,
    payload: String,
    /// As on Ethernet, padding included.
    frame: String,
}

#[test]
fn data_headers_are_read_as_the_vectors_say() {
    for vector in read().data {
        let bytes = unhex(&vector.header);
        let header = Header::read_from_bytes(&bytes[..]).expect("96 bytes");
        assert_eq!(header.flags, vector.flags);
        assert_eq!(header.hop_limit, vector.hop_limit);
        assert_eq!(header.egress_set, vector.egress_set);
        assert_eq!(header.payload_len(), vector.payload_length);
        assert_eq!(header.reserved, vector.reserved);
        assert_eq!(header.link_id(), vector.link_id);
        assert_eq!(header.link_counter(), vector.link_counter);
        assert_eq!(hex(&header.tag().to_be_bytes()), vector.tag);
        assert_eq!(hex(&header.egress_bits().to_be_bytes()), vector.egress_bits);
        assert_eq!(hex(header.destination.as_bytes()), vector.destination);
        assert_eq!(hex(header.source.as_bytes()), vector.source);

        let link = LinkEntry { id: vector.link_id, rx_keys: [key(&vector.key); 2], ..LinkEntry::default() };
        let length = Header::LEN + usize::from(vector.payload_length);
        let window = replay::empty();
        assert_eq!(forward::accept(&header, length - 1, &link, &window), Err(Counter::Truncated));
        assert_eq!(forward::accept(&header, length, &link, &window), Ok(FrameType::Data));
        assert_eq!(forward::accept(&header, length, &link, &window), Err(Counter::Replayed));
    }
}

#[test]
fn data_headers_are_written_as_the_vectors_say() {
    for vector in read().data {
        let name = |text: &str| Name::from_bytes(array(text));
        let mut header = Header::data(name(&vector.destination), name(&vector.source), vector.payload_length);
        (header.flags, header.hop_limit, header.egress_set) = (vector.flags, vector.hop_limit, vector.egress_set);
        header.reserved = vector.reserved;
        header.set_egress_bits(u64::from_be_bytes(array(&vector.egress_bits)));
        let (tx_keys, tx_phase) = ([key(&vector.key); 2], u32::from(vector.flags >> 7));
        let link = LinkEntry { peer_id: vector.link_id, tx_keys, tx_phase, ..LinkEntry::default() };
        hop::stamp(&mut header, &link, vector.link_counter.into());
        assert_eq!(hex(header.as_bytes()), vector.header);
    }
}

#[test]
fn control_frames_are_read_and_written_as_the_vectors_say() {
    for vector in read().control {
        let (frame, payload) = (unhex(&vector.frame), unhex(&vector.payload));
        assert_eq!(ControlHeader::parse(&frame), Some((vector.kind, &payload[..])));
        let header = ControlHeader::new(vector.kind, payload.len() as u16);
        assert!(frame.starts_with(&[header.as_bytes(), &payload].concat()));
    }
}

#[test]
fn the_file_holds_the_vectors_written_here() {
    let vectors = Vectors {
        about: vec![
            "Headers of frames; see ../wire-format.md. Bytes are hexadecimal and in wire order.".into(),
            "data: `tag` is the hop tag of `header` under `key`.".into(),
            "control: `frame` as it is on Ethernet (without the Ethernet header), padded to 46 bytes.".into(),
        ],
        data: data(),
        control: vec![
            control(ControlHeader::QUIC, b"a QUIC packet"),
            control(ControlHeader::QUIC, &[0x5a; 60]),
            control(ControlHeader::SOLICIT, &[]),
            control(ControlHeader::ANSWER, &[0xa5; 32]),
        ],
    };
    if std::env::var_os("GDP_BLESS").is_some() {
        let text = serde_json::to_string_pretty(&vectors).expect("plain data") + "\n";
        std::fs::write(FILE, text).expect("write");
    } else {
        assert_eq!(read(), vectors, "run GDP_BLESS=1 cargo test -p gdp-wire --test vectors");
    }
}

fn data() -> Vec<Data> {
    let ascending = |start: u8| std::array::from_fn(|i| start.wrapping_add(i as u8));
    let zero = Frame { payload: Vec::new(), ..Frame::default() };
    let plain = Frame {
        link_id: 0x1122_3344,
        link_counter: 1,
        destination: ascending(0x40),
        source: ascending(0xc0),
        payload: vec![0; 1404],
        ..Frame::default()
    };
    let all_fields = Frame {
        flags: 0xe7,
        hop_limit: 1,
        egress_set: 9,
        reserved: 0x80,
        link_counter: 0xffff_fffe,
        egress_bits: 1 << 63 | 0x0102_0304,
        ..plain.clone()
    };
    let ones = Frame { destination: [0xff; 32], source: [0xff; 32], egress_bits: u64::MAX, ..all_fields.clone() };
    let vectors = [
        ("01000000000000000000000000000000", zero),
        ("000102030405060708090a0b0c0d0e0f", plain),
        ("f0e0d0c0b0a090807060504030201000", all_fields),
        ("ffffffffffffffffffffffffffffffff", ones),
    ];
    vectors.map(|(text, frame)| data_vector(text, Frame { key: key(text), ..frame })).into()
}

fn data_vector(key: &str, frame: Frame) -> Data {
    let header = frame.header();
    Data {
        key: key.into(),
        flags: frame.flags,
        hop_limit: frame.hop_limit,
        egress_set: frame.egress_set,
        payload_length: frame.payload.len() as u16,
        reserved: frame.reserved,
        link_id: frame.link_id,
        link_counter: frame.link_counter as u32,
        tag: hex(&header[16..24]),
        egress_bits: hex(&frame.egress_bits.to_be_bytes()),
        destination: hex(&frame.destination),
        source: hex(&frame.source),
        header: hex(&header),
    }
}

fn control(kind: u8, payload: &[u8]) -> Control {
    let mut frame = vec![0x11, kind, 0, 0, 0, payload.len() as u8, 1, 0];
    frame.extend(payload);
    frame.resize(frame.len().max(46), 0);
    Control { kind, payload: hex(payload), frame: hex(&frame) }
}

fn read() -> Vectors {
    let text = std::fs::read_to_string(FILE).unwrap_or_else(|error| panic!("{FILE}: {error}"));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{FILE}: {error}"))
}
