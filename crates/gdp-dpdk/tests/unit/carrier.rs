//! Compares carriers with the tests' own bytewise reader and writer of the RFCs.

#[path = "../../../../tests/src/frames/carrier.rs"]
mod rfc;

use std::net::{IpAddr, SocketAddr};

use gdp_wire::table::{ip_of, ip_words, mac_words};
use gdp_wire::{Carrier, LocalAddress};

use super::{FrameLocation, MAX_LEN, Ours, Payload, Stations, checksum, encapsulate, find, has_checksum, len};

const ETHERTYPE: u16 = 0x88b5;
const PEER: [u8; 6] = [0x02, 0, 0, 0x12, 0x34, 0xfe];
const LOCAL: [u8; 6] = [0x06, 0, 0, 0xab, 0xcd, 0x01];
const VLANS: [u16; 2] = [5, 0xfff];

fn stations() -> Stations<'static> {
    Stations { peer: const { &mac_words(PEER) }, local: const { &mac_words(LOCAL) } }
}

fn address(text: &str) -> SocketAddr {
    text.parse().unwrap()
}

fn own_addresses() -> [SocketAddr; 3] {
    ["192.0.2.1:31415", "10.255.0.128:7", "[2001:db8::ff00:1]:31415"].map(address)
}

/// Addresses and VLANs of the switch in these tests.
struct Own;

impl Ours for Own {
    fn ethertype(&self) -> u16 {
        ETHERTYPE
    }

    fn is_ours(&self, address: &LocalAddress) -> bool {
        own_addresses().iter().any(|own| LocalAddress::new(own.ip(), own.port()) == *address)
    }

    fn is_our_vlan(&self, id: u16) -> bool {
        VLANS.contains(&id)
    }
}

/// Returns the frame that the reader of the RFCs finds.
fn expected(packet: &[u8]) -> Option<FrameLocation> {
    let place = rfc::find(packet, ETHERTYPE, &own_addresses(), &VLANS)?;
    let rfc::Place { at, length, over_udp, class } = place;
    Some(FrameLocation { at, available: length, over_udp, traffic: class })
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit as u64) as usize
    }

    fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.next() as u8).collect()
    }
}

fn over_udp(from: &str, to: &str, class: u8) -> rfc::Carrier {
    rfc::Carrier::Udp { from: address(from), to: address(to), class }
}

/// Returns packets to this switch with the frame, one for each carrier.
fn packets(frame: &[u8]) -> Vec<Vec<u8>> {
    let carriers = [
        rfc::Carrier::Ethernet,
        rfc::Carrier::Vlan(0xf005),
        rfc::Carrier::Vlan(0x0fff),
        over_udp("198.51.100.7:9", "192.0.2.1:31415", 0xa2),
        over_udp("198.51.100.7:9", "10.255.0.128:7", 0),
        over_udp("[2001:db8::2]:31415", "[2001:db8::ff00:1]:31415", 0x5b),
    ];
    carriers.iter().map(|carrier| carrier.carry(LOCAL, PEER, ETHERTYPE, frame)).collect()
}

#[test]
fn finds_what_is_ours() {
    let frame = [0x10; 100];
    let found: Vec<_> = packets(&frame).iter().map(|packet| find(packet, &Own)).collect();
    let carried = |at, over_udp, traffic| Some(FrameLocation { at, available: 100, over_udp, traffic });
    let expected = [
        carried(14, false, 0),
        carried(18, false, 0),
        carried(18, false, 0),
        carried(42, true, 0xa2),
        carried(42, true, 0),
        carried(62, true, 0x5b),
    ];
    assert_eq!(found, expected);
    for packet in packets(&[]) {
        assert_eq!(find(&packet, &Own).map(|found| (found.at, found.available)), Some((packet.len(), 0)));
    }
}

#[test]
fn padding_is_behind_a_datagram_and_in_what_is_on_ethernet() {
    for mut packet in packets(&[0x10; 3]) {
        packet.resize(packet.len() + 20, 0);
        let found = find(&packet, &Own).unwrap();
        assert_eq!(found.available, if found.over_udp { 3 } else { 23 });
    }
}

/// A change of a packet: offset and new byte.
type Change = (usize, u8);

/// Returns a packet with some bytes changed.
fn changed(packet: &[u8], changes: &[Change]) -> Vec<u8> {
    let mut packet = packet.to_vec();
    changes.iter().for_each(|(at, byte)| packet[*at] = *byte);
    packet
}

#[test]
fn what_is_malformed_is_the_hosts() {
    let [_, tagged, _, v4, _, v6] = packets(&[0x10; 100]).try_into().unwrap();
    // The IPv4 header states 128 bytes, the UDP header 108.
    let cases: [(&str, &[u8], &[Change]); 27] = [
        ("another VLAN", &tagged, &[(15, 6)]),
        ("another VLAN, in the high bits", &tagged, &[(14, 0x01)]),
        ("IP on a VLAN", &tagged, &[(16, 0x08), (17, 0x00)]),
        ("two tags", &tagged, &[(16, 0x81), (17, 0x00)]),
        ("a service tag", &tagged, &[(12, 0x88), (13, 0xa8)]),
        ("another ethertype", &v4, &[(12, 0x08), (13, 0x06)]),
        ("IPv6's in front of IPv4", &v4, &[(12, 0x86), (13, 0xdd)]),
        ("options", &v4, &[(14, 0x46)]),
        ("too short a header", &v4, &[(14, 0x44)]),
        ("version 6 in IPv4", &v4, &[(14, 0x65)]),
        ("TCP", &v4, &[(23, 6)]),
        ("more fragments", &v4, &[(20, 0x20)]),
        ("a later fragment", &v4, &[(21, 1)]),
        ("the place of a fragment", &v4, &[(20, 0x50)]),
        ("another address", &v4, &[(33, 2)]),
        ("another port", &v4, &[(37, 0xb8)]),
        ("the port of another address", &v4, &[(36, 0), (37, 7)]),
        ("a datagram beyond IPv4's end", &v4, &[(39, 109)]),
        ("a datagram shorter than its header", &v4, &[(39, 7)]),
        ("IPv4 beyond the packet's end", &v4, &[(17, 129)]),
        ("IPv4 shorter than its datagram", &v4, &[(17, 127)]),
        ("version 4 in IPv6", &v6, &[(14, 0x45)]),
        ("a fragment header", &v6, &[(20, 44)]),
        ("another address's last byte", &v6, &[(53, 2)]),
        ("a datagram beyond IPv6's end", &v6, &[(59, 109)]),
        ("IPv6 beyond the packet's end", &v6, &[(19, 109)]),
        ("a datagram in IPv6 shorter than its header", &v6, &[(59, 0)]),
    ];
    for (case, packet, changes) in cases {
        assert!(find(packet, &Own).is_some());
        let packet = changed(packet, changes);
        assert_eq!((find(&packet, &Own), expected(&packet)), (None, None), "{case}");
    }
    let (reserved, mut shorter) = (changed(&v4, &[(20, 0xc0)]), changed(&v4, &[(39, 107)]));
    assert_eq!(find(&reserved, &Own).map(|found| found.available), Some(100), "neither bit makes it a fragment");
    assert_eq!(find(&shorter, &Own).map(|found| found.available), Some(99), "the datagram's length counts");
    shorter.pop();
    assert_eq!(find(&shorter, &Own), None, "but all that IPv4 tells of must be there");
}

#[test]
fn reads_every_packet_as_the_rfcs_do_where_a_byte_differs_or_the_end_is_missing() {
    for packet in packets(&[0x10; 9]) {
        for length in 0..=packet.len() {
            assert_eq!(find(&packet[..length], &Own), expected(&packet[..length]), "{length} bytes of {packet:02x?}");
        }
        for at in 0..packet.len() {
            for byte in 0..=255 {
                let packet = changed(&packet, &[(at, byte)]);
                assert_eq!(find(&packet, &Own), expected(&packet), "{packet:02x?}");
            }
        }
    }
}

#[test]
fn reads_random_packets_as_the_rfcs_do() {
    let mut random = Random(1);
    let mut found = 0;
    for _ in 0..200_000 {
        let frame = random.below(120);
        let frame = random.bytes(frame);
        let packets = packets(&frame);
        let mut packet = packets[random.below(packets.len())].clone();
        for _ in 0..random.below(4) {
            let (at, byte) = (random.below(packet.len().min(64)), random.next() as u8);
            packet[at] = byte;
        }
        let length = if random.below(4) == 0 { random.below(packet.len() + 9) } else { packet.len() };
        packet.resize(length, 0);
        assert_eq!(find(&packet, &Own), expected(&packet), "{packet:02x?}");
        found += usize::from(find(&packet, &Own).is_some());
    }
    assert!(found > 50_000, "{found}");
    for _ in 0..200_000 {
        let length = random.below(100);
        let mut packet = random.bytes(length);
        let ethertypes = [[0x88, 0xb5], [0x81, 0], [0x08, 0], [0x86, 0xdd]];
        packet.iter_mut().skip(12).zip(ethertypes[random.below(4)]).for_each(|(byte, known)| *byte = known);
        assert_eq!(find(&packet, &Own), expected(&packet), "{packet:02x?}");
    }
}

fn udp_carrier(from: &str, to: &str, flags: u8) -> Carrier {
    let (from, to) = (address(from), address(to));
    let ((kind, peer_ip), (_, local_ip)) = (ip_words(to.ip()), ip_words(from.ip()));
    let (peer_port, local_port) = (to.port().to_be(), from.port().to_be());
    Carrier { kind, flags, peer_ip, local_ip, peer_port, local_port, ..Carrier::default() }
}

/// Returns carriers from a neighbour to this switch, and whether their payload has a UDP checksum.
fn carriers() -> Vec<(Carrier, bool)> {
    let v4 = |flags| udp_carrier("198.51.100.7:9", "192.0.2.1:31415", flags);
    let v6 = |flags| udp_carrier("[fe80::1234:5678:9abc]:50000", "[2001:db8::ff00:1]:31415", flags);
    vec![
        (Carrier::default(), false),
        (Carrier { vlan: 5, ..Carrier::default() }, false),
        (Carrier { vlan: 0x3fff, ..Carrier::default() }, false),
        (v4(0), false),
        (v4(Carrier::ZERO_CHECKSUM), false),
        (v4(Carrier::CHECKSUM), true),
        (v6(0), true),
        (v6(Carrier::ZERO_CHECKSUM), false),
        (v6(Carrier::CHECKSUM), true),
        (v6(Carrier::CHECKSUM | Carrier::ZERO_CHECKSUM), true),
    ]
}

fn whole(frame: &[u8]) -> Payload<'_> {
    Payload { length: frame.len(), bytes: frame }
}

/// The remaining bytes of a frame may be elsewhere.
#[test]
fn without_a_checksum_the_length_of_a_frame_is_enough() {
    let frame = [7; 300];
    for (carrier, _) in carriers().into_iter().filter(|(carrier, _)| !has_checksum(carrier)) {
        let mut front = vec![0xa5; len(&carrier)];
        encapsulate(&mut front, Payload { length: 300, bytes: &frame[..96] }, &carrier, stations(), 0, ETHERTYPE);
        assert_eq!(front, dressed(&carrier, &frame, 0), "{carrier:?}");
    }
}

/// Returns the headers, which overwrite the previous contents.
fn dressed(carrier: &Carrier, frame: &[u8], traffic: u8) -> Vec<u8> {
    let mut front = vec![0xa5; len(carrier)];
    encapsulate(&mut front, whole(frame), carrier, stations(), traffic, ETHERTYPE);
    front
}

/// Returns the headers from the writer of the RFCs, which does not write UDP checksums.
fn headers(carrier: &Carrier, frame: &[u8], traffic: u8) -> Vec<u8> {
    let end = |words, port: u16| SocketAddr::new(ip_of(carrier.kind, words), u16::from_be(port));
    let by = match carrier.kind {
        Carrier::ETHERNET if carrier.vlan == 0 => rfc::Carrier::Ethernet,
        Carrier::ETHERNET => rfc::Carrier::Vlan(u16::from(traffic / 32) * 0x2000 + carrier.vlan % 0x1000),
        _ => rfc::Carrier::Udp {
            from: end(carrier.local_ip, carrier.local_port),
            to: end(carrier.peer_ip, carrier.peer_port),
            class: traffic,
        },
    };
    let mut packet = by.carry(PEER, LOCAL, ETHERTYPE, frame);
    packet.truncate(packet.len() - frame.len());
    packet
}

/// Returns the pseudo header of RFC 768 or RFC 8200 and the datagram of a packet.
fn summed_up(carrier: &Carrier, packet: &[u8]) -> Vec<u8> {
    let (addresses, udp) = if carrier.kind == Carrier::UDP4 { (26..34, 34) } else { (22..54, 54) };
    let length = (packet.len() - udp) as u32;
    [&packet[addresses], &length.to_be_bytes(), &[0, 0, 0, 17], &packet[udp..]].concat()
}

#[test]
fn writes_the_headers_of_the_rfcs() {
    let mut random = Random(2);
    for length in [0, 1, 2, 3, 4, 5, 96, 97, 1400, 1437, 9000, 9801, 65_507] {
        for (carrier, has_checksum) in carriers() {
            let (frame, traffic) = (random.bytes(length), random.next() as u8);
            let mut front = dressed(&carrier, &frame, traffic);
            if has_checksum {
                let packet = [&front[..], &frame].concat();
                assert_eq!(rfc::internet_checksum(&summed_up(&carrier, &packet)), 0, "{carrier:?}, {length}");
                let at = front.len() - 2;
                assert_ne!(front[at..], [0, 0]);
                front[at..].fill(0);
            }
            assert_eq!(front, headers(&carrier, &frame, traffic), "{carrier:?}, {length}, {traffic:#x}");
        }
    }
}

#[test]
fn writes_these_bytes() {
    let carrier = udp_carrier("198.51.100.7:9", "192.0.2.1:31415", 0);
    let expected = [
        &[0x02, 0, 0, 0x12, 0x34, 0xfe, 0x06, 0, 0, 0xab, 0xcd, 0x01, 0x08, 0x00][..],
        // The checksum: 0x4522 + 0x0020 + 0x4000 + 0x4011 + 0xc633 + 0x6407 + 0xc000 + 0x0201 =
        // 0x2b18e, 0xb190 folded.
        &[0x45, 0x22, 0, 32, 0, 0, 0x40, 0, 64, 17, 0x4e, 0x6f, 198, 51, 100, 7, 192, 0, 2, 1],
        &[0, 9, 0x7a, 0xb7, 0, 12, 0, 0],
    ];
    assert_eq!(dressed(&carrier, b"four", 0x22), expected.concat());
    let tagged = Carrier { vlan: 5, ..Carrier::default() };
    assert_eq!(dressed(&tagged, b"four", 0xe3)[12..], [0x81, 0, 0xe0, 5, 0x88, 0xb5]);
}

#[test]
fn a_checksum_that_comes_to_zero_is_written_as_all_ones() {
    for (carrier, _) in carriers().into_iter().filter(|(_, has_checksum)| *has_checksum) {
        let mut frame = [0x10; 98];
        frame[96..].fill(0);
        // Add the difference to a sum of 0xffff, which is the checksum of the original frame.
        let front = headers(&carrier, &frame, 0);
        let missing = rfc::internet_checksum(&summed_up(&carrier, &[&front[..], &frame].concat()));
        frame[96..].copy_from_slice(&missing.to_be_bytes());
        let front = dressed(&carrier, &frame, 0);
        assert_eq!(front[front.len() - 2..], [0xff, 0xff], "{carrier:?}");
    }
}

#[test]
fn what_is_put_on_is_found_again() {
    let mut random = Random(3);
    for (carrier, _) in carriers() {
        for traffic in 0..=255 {
            let frame = random.below(2000);
            let frame = random.bytes(frame);
            let packet = [&dressed(&carrier, &frame, traffic)[..], &frame].concat();
            let over_udp = carrier.kind != Carrier::ETHERNET;
            let traffic = if over_udp { traffic } else { 0 };
            let at = len(&carrier);
            let found = FrameLocation { at, available: frame.len(), over_udp, traffic };
            assert_eq!(find(&packet, &Own), Some(found), "{carrier:?}");
        }
    }
}

#[test]
fn a_front_of_another_length_stays_as_it_is() {
    for (carrier, _) in carriers() {
        for length in (0..=MAX_LEN + 9).filter(|length| *length != len(&carrier)) {
            let mut front = vec![0xa5; length];
            encapsulate(&mut front, whole(b"frame"), &carrier, stations(), 0, ETHERTYPE);
            assert!(front.iter().all(|byte| *byte == 0xa5), "{carrier:?}, {length}");
        }
    }
}

#[test]
fn no_carrier_makes_it_panic() {
    let mut random = Random(4);
    let frame = vec![0xff; 70_000];
    for _ in 0..2_000 {
        let carrier = Carrier {
            kind: random.next() as u8 % 5,
            flags: random.next() as u8,
            vlan: random.next() as u16,
            peer_port: random.next() as u16,
            peer_ip: [random.next() as u32; 4],
            local_ip: [u32::MAX; 4],
            ..Carrier::default()
        };
        let length = if random.below(8) == 0 { 65_500 + random.below(4_500) } else { random.below(300) };
        dressed(&carrier, &frame[..length], random.next() as u8);
    }
}

#[test]
fn sums_up_as_rfc_1071_does() {
    let mut random = Random(5);
    for length in (0..200).chain([1499, 1500, 9000, 65_535]) {
        for bytes in [random.bytes(length), vec![0xff; length], vec![0; length]] {
            let sum = !checksum::fold(checksum::sum(&bytes));
            assert_eq!(u16::from_be_bytes(sum.to_ne_bytes()), rfc::internet_checksum(&bytes), "{length}");
        }
    }
    // The example of RFC 1071, 3.
    let sum = checksum::fold(checksum::sum(&[0x00, 0x01, 0xf2, 0x03, 0xf4, 0xf5, 0xf6, 0xf7]));
    assert_eq!(sum.to_ne_bytes(), [0xdd, 0xf2]);
}

#[test]
fn folds_any_sum() {
    let mut random = Random(6);
    let edges = [0, 1, 0xffff, 0x1_0000, 0xffff_ffff, 0x1_0000_0000, u64::MAX - 1, u64::MAX, 0xffff_ffff_0000_ffff];
    for sum in edges.into_iter().chain((0..10_000).map(|_| random.next())) {
        // The remainder modulo 2^16 - 1, except that nonzero multiples are represented by the
        // modulus itself.
        let expected = if sum == 0 { 0 } else { (sum - 1) % 0xffff + 1 };
        assert_eq!(u64::from(checksum::fold(sum)), expected, "{sum:#x}");
    }
}

#[test]
fn addresses_are_told_apart_by_their_kind() {
    struct Kinds;
    impl Ours for Kinds {
        fn ethertype(&self) -> u16 {
            ETHERTYPE
        }

        fn is_ours(&self, address: &LocalAddress) -> bool {
            let ip: IpAddr = ip_of(address.kind as u8, address.ip);
            *address == LocalAddress::new(ip, u16::from_be(address.port)) && ip.is_ipv6()
        }

        fn is_our_vlan(&self, _id: u16) -> bool {
            false
        }
    }
    let found: Vec<_> = packets(b"frame").iter().map(|packet| find(packet, &Kinds).map(|found| found.at)).collect();
    assert_eq!(found, [Some(14), None, None, None, None, Some(62)]);
}
