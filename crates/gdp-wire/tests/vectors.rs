//! `docs/vectors/header.json`: headers field by field and byte by byte, for other implementations.
//! This test checks them against [`Header`] and [`forward::accept`]. `GDP_BLESS=1 cargo test -p
//! gdp-wire` writes the file with the frame builder of the tests, which does not use [`Header`].

#[path = "../../../tests/src/frames/mod.rs"]
mod frames;

use frames::Frame;
use frames::fixtures::{array, hex, key, unhex};
use gdp_wire::{ControlHeader, Counter, ErrorCode, FrameType, Header, LinkEntry, Name, forward, hop, replay};
use serde::{Deserialize, Serialize};
use zerocopy::{FromBytes, IntoBytes};

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/vectors/header.json");

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Vectors {
    about: Vec<String>,
    data: Vec<Data>,
    errors: Vec<ErrorFrame>,
    echoes: Vec<Echo>,
    probes: Vec<Probe>,
    refused: Vec<Refused>,
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
    /// Count of the frame on the link; the header has its low 32 bits.
    count: u64,
    /// As on the wire.
    tag: String,
    egress_bits: String,
    destination: String,
    source: String,
    header: String,
}

/// The error about a dropped data frame, without payload.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct ErrorFrame {
    key: String,
    link_id: u32,
    count: u64,
    code: u8,
    mtu: u32,
    /// Header of the dropped frame.
    dropped: String,
    error: String,
}

/// An echo and its answer, both under one key and link id here.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Echo {
    key: String,
    link_id: u32,
    count: u64,
    cookie: String,
    question: String,
    answer: String,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Probe {
    key: String,
    link_id: u32,
    count: u64,
    egress_bit: u8,
    cookie: String,
    /// With its payload.
    frame: String,
}

/// A frame that its receiver drops.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Refused {
    description: String,
    key: String,
    link_id: u32,
    /// Counts that the receiver has accepted before.
    accepted: Vec<u64>,
    frame: String,
    counter: String,
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
        reach(&window, vector.count);
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
        hop::stamp(&mut header, &link, vector.count);
        assert_eq!(hex(header.as_bytes()), vector.header);
    }
}

#[test]
fn errors_echoes_and_probes_are_written_and_read_as_the_vectors_say() {
    let sent = |mut header: Header, key_text: &str, id: u32, count: u64| {
        let link = LinkEntry { peer_id: id, tx_keys: [key(key_text); 2], ..LinkEntry::default() };
        hop::stamp(&mut header, &link, count);
        let receiver = LinkEntry { id, rx_keys: [key(key_text); 2], ..LinkEntry::default() };
        let window = replay::empty();
        reach(&window, count);
        (header, forward::accept(&header, header.frame_len(), &receiver, &window))
    };
    for vector in read().errors {
        let mut header = Header::read_from_bytes(&unhex(&vector.dropped)).expect("96 bytes");
        let dropped = header.link_counter();
        header.become_error(ErrorCode::from_number(vector.code).expect("a code"), vector.mtu);
        let (header, accepted) = sent(header, &vector.key, vector.link_id, vector.count);
        assert_eq!((hex(header.as_bytes()), accepted), (vector.error, Ok(FrameType::Error)));
        assert_eq!(header.complaint(), (vector.mtu, dropped));
    }
    for vector in read().echoes {
        let cookie = u64::from_be_bytes(array(&vector.cookie));
        let (mut header, accepted) = sent(Header::echo(cookie), &vector.key, vector.link_id, vector.count);
        assert_eq!((hex(header.as_bytes()), accepted), (vector.question, Ok(FrameType::Echo)));
        header.become_answer();
        let (header, accepted) = sent(header, &vector.key, vector.link_id, vector.count);
        assert_eq!((hex(header.as_bytes()), accepted), (vector.answer, Ok(FrameType::Echo)));
    }
    for vector in read().probes {
        let bytes = unhex(&vector.frame);
        let (name, source) = (array(&hex(&bytes[32..64])), array(&hex(&bytes[64..96])));
        let probe = Header::probe(Name::from_bytes(name), Name::from_bytes(source), vector.egress_bit, 64);
        let (header, accepted) = sent(probe, &vector.key, vector.link_id, vector.count);
        let frame = [header.as_bytes(), &unhex(&vector.cookie)].concat();
        assert_eq!((hex(&frame), accepted), (vector.frame, Ok(FrameType::Probe)));
    }
}

#[test]
fn frames_are_dropped_as_the_vectors_say() {
    for vector in read().refused {
        let bytes = unhex(&vector.frame);
        let link = LinkEntry { id: vector.link_id, rx_keys: [key(&vector.key), [0; 2]], ..LinkEntry::default() };
        let window = replay::empty();
        vector.accepted.iter().for_each(|count| assert!(replay::take(&window, *count)));
        let header = Header::read_from_prefix(&bytes).expect("a header").0;
        let refused = forward::accept(&header, bytes.len(), &link, &window).expect_err(&vector.description);
        assert_eq!(refused.as_str(), vector.counter, "{}", vector.description);
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
            "data: `count` is the frame's count on its link. From 2^32 on, the receiver has accepted the counts before it."
                .into(),
            "errors: `dropped` is the header of the frame that the error is about.".into(),
            "refused: frames that a receiver with `key` for key phase 0 and no other key drops, after it has accepted the \
             counts `accepted`; `counter` is the first check that fails."
                .into(),
            "control: `frame` as it is on Ethernet (without the Ethernet header), padded to 46 bytes.".into(),
        ],
        data: data(),
        errors: errors(),
        echoes: echoes(),
        probes: probes(),
        refused: refused(),
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
    let late = Frame { link_counter: 0x0000_1122_5566_7788, ..plain.clone() };
    let after = Frame { link_counter: 1 << 32, ..plain.clone() };
    let vectors = [
        ("000102030405060708090a0b0c0d0e0f", after),
        ("000102030405060708090a0b0c0d0e0f", late),
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
        count: frame.link_counter,
        tag: hex(&header[16..24]),
        egress_bits: hex(&frame.egress_bits.to_be_bytes()),
        destination: hex(&frame.destination),
        source: hex(&frame.source),
        header: hex(&header),
    }
}

const KEY: &str = "000102030405060708090a0b0c0d0e0f";

/// A small data frame from an endpoint, without egress bits.
fn small() -> Frame {
    Frame {
        link_id: 0x1122_3344,
        link_counter: 7,
        destination: [0x40; 32],
        source: [0xc0; 32],
        key: key(KEY),
        ..Frame::default()
    }
}

fn errors() -> Vec<ErrorFrame> {
    let causes = [(1, 0, 0), (2, 1280, 0), (3, 0, 0), (4, 0, 0xff)];
    let error = |(code, mtu, flags): (u8, u32, u8)| {
        let dropped = Frame { flags, reserved: 1, egress_bits: 9, ..small() };
        let answer = Frame {
            version_type: 0x22,
            // Key phase 0 of this link; neither foreign nor ECN.
            flags: flags & 0x3c,
            hop_limit: 1,
            egress_set: code,
            link_id: 0x5566_7788,
            link_counter: 2,
            egress_bits: u64::from(mtu) << 32 | 7,
            payload: Vec::new(),
            ..small()
        };
        ErrorFrame {
            key: KEY.into(),
            link_id: answer.link_id,
            count: answer.link_counter,
            code,
            mtu,
            dropped: hex(&dropped.header()),
            error: hex(&answer.header()),
        }
    };
    causes.map(error).into()
}

fn echoes() -> Vec<Echo> {
    let cookie = 0x0102_0304_0506_0708;
    let frame = |egress_set, count| Frame {
        version_type: 0x24,
        hop_limit: 1,
        egress_set,
        link_counter: count,
        egress_bits: cookie,
        destination: [0; 32],
        source: [0; 32],
        payload: Vec::new(),
        ..small()
    };
    let echo = |count| Echo {
        key: KEY.into(),
        link_id: small().link_id,
        count,
        cookie: hex(&cookie.to_be_bytes()),
        question: hex(&frame(0, count).header()),
        answer: hex(&frame(1, count).header()),
    };
    [1, (1 << 32) + 1].map(echo).into()
}

fn probes() -> Vec<Probe> {
    let cookie = [1, 2, 3, 4, 5, 6, 7, 8];
    let probe = |bit: u8| Probe {
        key: KEY.into(),
        link_id: small().link_id,
        count: small().link_counter,
        egress_bit: bit,
        cookie: hex(&cookie),
        frame: hex(&Frame { version_type: 0x23, egress_bits: 1 << bit, payload: cookie.into(), ..small() }.carried()),
    };
    [0, 63].map(probe).into()
}

fn refused() -> Vec<Refused> {
    let cases = [
        ("version 1", vec![], small_with(|frame| frame.version_type = 0x10), Counter::Unknown),
        ("version 3", vec![], small_with(|frame| frame.version_type = 0x30), Counter::Unknown),
        ("an unknown type", vec![], small_with(|frame| frame.version_type = 0x25), Counter::Unknown),
        ("a control frame's type", vec![], small_with(|frame| frame.version_type = 0x11), Counter::Unknown),
        ("a header of 104 bytes", vec![], small_with(|frame| frame.header_words = 13), Counter::Unknown),
        (
            "a payload longer than the frame",
            vec![],
            small_with(|frame| frame.payload_len = Some(7)),
            Counter::Truncated,
        ),
        ("the id of another link", vec![], small_with(|frame| frame.link_id += 1), Counter::NoLink),
        ("the tag of another key", vec![], small_with(|frame| frame.key[0] ^= 1), Counter::BadTag),
        ("a key phase without a key", vec![], small_with(|frame| frame.flags = 0x80), Counter::BadTag),
        ("a count that was accepted", vec![7], small(), Counter::Replayed),
        ("a count that is too old", vec![7 + 4096], small(), Counter::Replayed),
        ("the count of a frame 2^32 earlier", vec![7 + (1 << 32)], small(), Counter::BadTag),
    ];
    let mut all: Vec<Refused> = cases
        .into_iter()
        .map(|(description, accepted, frame, counter)| Refused {
            description: description.into(),
            key: KEY.into(),
            link_id: small().link_id,
            accepted,
            frame: hex(&frame.carried()),
            counter: counter.as_str().into(),
        })
        .collect();
    // What the tag covers, and what it does not.
    for (at, what) in [(1, "flags"), (2, "hop limit"), (3, "egress set"), (24, "egress bits"), (32, "destination")] {
        let mut frame = small().carried();
        frame[at] ^= 1;
        all.push(Refused {
            description: format!("changed on the way: {what}"),
            key: KEY.into(),
            link_id: small().link_id,
            accepted: vec![],
            frame: hex(&frame),
            counter: Counter::BadTag.as_str().into(),
        });
    }
    all
}

fn small_with(change: impl FnOnce(&mut Frame)) -> Frame {
    let mut frame = small();
    change(&mut frame);
    frame
}

/// Lets a window expect a count beyond 2³², as after the frames before it.
fn reach(window: &replay::Window, count: u64) {
    if count >> 32 != 0 {
        (1..=256).rev().for_each(|blocks| assert!(replay::take(window, count - 16 * blocks)));
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
