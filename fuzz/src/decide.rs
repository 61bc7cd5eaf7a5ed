//! Frames as they come from a cable, through the parser and the forwarding decision of both kinds
//! of data plane.
//!
//! The input is a few frames for one switch, the one of `tests/fixtures/frames.json`: a byte of
//! options, two of length, and the Ethernet frame; until there is nothing left. Nobody guesses a
//! hop tag, so a frame whose options say so is tagged with the key of the link it says it is on.

use std::collections::HashSet;
use std::sync::OnceLock;

use gdp_wire::Counter;

use crate::frames::fixtures::{self, Link, Role, Switch, Verdict};
use crate::frames::hop_tag;
use crate::tables::{Fate, PlainTables};

/// Frames of an input that are looked at.
const MAX_FRAMES: usize = 16;

const ETHERNET: usize = 14;
const HEADER: usize = 96;

/// Of a header's flags.
const CLASS: u8 = 0x1c;
const ECN: u8 = 0x03;

/// Option of a frame: the neighbour made it, so its tag is good.
pub const TAGGED: u8 = 1;
/// Option of a frame: it comes twice.
pub const TWICE: u8 = 2;

/// What becomes of frames is what [`check`] says, for every frame and in both planes.
pub fn decide(data: &[u8]) {
    let switch = switch();
    let (kernel, userspace) = (PlainTables::<true>::new(switch), PlainTables::<false>::new(switch));
    for (options, mut frame) in frames(data) {
        if options & TAGGED != 0 {
            tag(&mut frame, switch);
        }
        let fates = [kernel.run(&frame), userspace.run(&frame)];
        fates.iter().for_each(|fate| check(&frame, fate, switch));
        let [kernel_fate, userspace_fate] = fates;
        let left_alone = [Counter::Slow, Counter::RedirectFailed];
        if !left_alone.contains(&kernel_fate.counter) && kernel_fate.verdict != Verdict::Send {
            assert_eq!(kernel_fate.counter, userspace_fate.counter, "the planes do not agree");
        }
        if options & TWICE != 0 {
            let again = userspace.run(&frame);
            let never_counted = matches!(again.verdict, Verdict::Pass | Verdict::Drop);
            assert!(never_counted && again.frame.is_none() && again.copies.is_empty(), "it was taken twice: {again:?}");
        }
    }
}

/// That a plane did with a frame what its fate says, and that this is allowed.
fn check(frame: &[u8], fate: &Fate, switch: &Switch) {
    match fate.verdict {
        Verdict::Drop => assert!(fate.counter.is_drop(), "{fate:?}"),
        Verdict::Pass => assert!(!fate.counter.is_drop() && fate.frame.is_none(), "{fate:?}"),
        Verdict::Send => {
            let sent = fate.frame.as_ref().expect("what is sent");
            check_sent(frame, sent, switch);
            assert!(fate.copies.is_empty());
        }
        Verdict::Copy => {
            assert_eq!(fate.counter, Counter::Replicated);
            check_copies(frame, fate, switch);
        }
    }
}

/// A frame that leaves does so by a link, tagged for it, and is no longer than it came. Only what
/// has come with a good tag leaves. Returns the link, and the header as it leaves.
fn check_sent<'s>(packet: &[u8], sent: &[u8], switch: &'s Switch) -> (&'s Link, [u8; HEADER]) {
    let (&came, payload) = parts(frame_in(packet, switch).expect("what is not for this switch does not leave by it"));
    let (link, sent) = sent_by(sent, switch);
    let (&left, rest) = parts(sent);
    let ingress = switch.link(word(&came, 8)).expect("a link");
    assert!(is_tagged(&came, &ingress.rx_keys, came[1] & 0x80 != 0), "nobody made this frame");
    assert!(is_tagged(&left, &link.tx_keys, link.tx_phase != 0), "sent with another tag");
    assert_eq!(u32::from(left[1] >> 7), link.tx_phase, "the wrong key phase");
    assert_eq!(left[32..], came[32..], "names changed");
    if matches!(left[0], 0x20 | 0x23) {
        assert_eq!((came[0], left[2] + 1), (left[0], came[2]), "the hop limit falls by one");
        let length = usize::from(u16::from_be_bytes([came[4], came[5]]));
        assert_eq!(*rest, payload[..length], "the payload changed");
        let marked = switch.find(packet).is_some_and(|place| place.class & ECN == ECN);
        assert!(came[1] & ECN != 0 || !marked, "only a loss tells its writer of congestion");
        let ecn = if marked { ECN } else { came[1] & ECN };
        assert_eq!(left[1] & (CLASS | ECN), came[1] & CLASS | ecn, "the class or the code point is another");
        assert_ne!(link.id, ingress.id, "back to where it came from");
        assert!(sent.len() <= link.mtu as usize, "longer than the link takes");
    } else {
        assert_eq!(left[1] & ECN, 0, "an answer takes no marks");
        assert_eq!((link.id, rest.len()), (ingress.id, 0), "an answer goes to who is answered, and is short");
        let answers_what_it_may = (left[0], came[0]) == (0x22, 0x20) || (left[0], came[0], came[3]) == (0x24, 0x24, 0);
        assert!(answers_what_it_may, "type {:#x} answers type {:#x}", left[0], came[0]);
    }
    (link, left)
}

/// Each link gets one copy at most, and each egress bit goes to one neighbour at most.
fn check_copies(packet: &[u8], fate: &Fate, switch: &Switch) {
    let (mut links, mut bits) = (HashSet::new(), 0);
    for (copy, counter) in &fate.copies {
        let Some(copy) = copy else {
            assert_eq!(*counter, Counter::TooBig);
            continue;
        };
        let (link, header) = check_sent(packet, copy, switch);
        assert!(links.insert(link.id), "two copies for {}", link.label);
        let carried = u64::from_be_bytes(header[24..32].try_into().expect("eight bytes"));
        if link.role == Role::Switch {
            assert!(carried != 0 && carried & !link.entry().reach == 0, "bits that {} does not lead to", link.label);
            // The fixtures' neighbours share no egress switch.
            assert_eq!(carried & bits, 0, "bits that another neighbour got");
            bits |= carried;
        } else {
            assert_eq!(carried, 0, "an endpoint gets bits");
        }
    }
}

fn frames(mut data: &[u8]) -> impl Iterator<Item = (u8, Vec<u8>)> {
    let next = move || {
        let ([options, high, low], rest) = data.split_first_chunk()?;
        let length = usize::from(u16::from_be_bytes([*high, *low])).min(rest.len());
        let (frame, behind) = rest.split_at(length);
        data = behind;
        let mut frame = frame.to_vec();
        // There is no shorter one on Ethernet.
        frame.resize(length.max(ETHERNET), 0);
        Some((*options, frame))
    };
    std::iter::from_fn(next).take(MAX_FRAMES)
}

/// Writes the tag that the neighbour would have written. The high half of its count is that of what
/// was taken last.
fn tag(packet: &mut [u8], switch: &Switch) {
    let Some(place) = switch.find(packet) else { return };
    let Some(bytes) = packet[place.at..place.at + place.length].first_chunk_mut::<HEADER>() else { return };
    let Some(link) = switch.link(word(bytes, 8)) else { return };
    let taken = link.taken.iter().max().copied().unwrap_or(0);
    let count = taken & !0xffff_ffff | u64::from(word(bytes, 12));
    let key = fixtures::key(&link.rx_keys[usize::from(bytes[1] >> 7)]);
    let tag = hop_tag(key, count, bytes);
    bytes[16..24].copy_from_slice(&tag.to_be_bytes());
}

/// Whether the tag is right, whatever the high half of the count.
fn is_tagged(header: &[u8; HEADER], keys: &[String; 2], second: bool) -> bool {
    const HIGHEST: u64 = 4;
    let low = u64::from(word(header, 12));
    let tag = u64::from_be_bytes(header[16..24].try_into().expect("eight bytes"));
    (0..HIGHEST).any(|high| hop_tag(fixtures::key(&keys[usize::from(second)]), high << 32 | low, header) == tag)
}

/// The link by which a packet leaves, and the frame in it.
fn sent_by<'s, 'p>(packet: &'p [u8], switch: &'s Switch) -> (&'s Link, &'p [u8]) {
    let by = |link: &'s Link| {
        let in_front = link.carry(switch.ethertype, &[0; HEADER]).len() - HEADER;
        let frame = packet.get(in_front..).filter(|frame| frame.len() >= HEADER)?;
        let is_it = word(parts(frame).0, 8) == link.peer_id && link.carry(switch.ethertype, frame) == packet;
        is_it.then_some((link, frame))
    };
    switch.links.iter().find_map(by).expect("a link that carries it so")
}

/// The frame for this switch in a packet.
fn frame_in<'p>(packet: &'p [u8], switch: &Switch) -> Option<&'p [u8]> {
    switch.find(packet).map(|place| &packet[place.at..place.at + place.length])
}

fn parts(frame: &[u8]) -> (&[u8; HEADER], &[u8]) {
    frame.split_first_chunk().expect("a whole header")
}

fn word(header: &[u8; HEADER], at: usize) -> u32 {
    u32::from_be_bytes(header[at..at + 4].try_into().expect("four bytes"))
}

fn switch() -> &'static Switch {
    static SWITCH: OnceLock<Switch> = OnceLock::new();
    SWITCH.get_or_init(|| fixtures::read().switch)
}
