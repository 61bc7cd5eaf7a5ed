//! Unit tests of `header`.

use super::*;

#[test]
fn fields_are_where_the_wire_format_says() {
    let mut header = Header::data(Name::from_bytes([0xd0; 32]), Name::from_bytes([0x50; 32]), 0x0102);
    header.set_link_id(0x1122_3344);
    header.set_link_counter(0x5566_7788);
    header.set_tag(0x0a0b_0c0d_0e0f_1011);
    header.set_egress_bits(1 << 63 | 2);
    header.egress_set = 7;
    let bytes = header.as_bytes();
    assert_eq!(bytes[..8], [0x20, 0, 64, 7, 1, 2, 12, 0]);
    assert_eq!(bytes[8..16], [0x11, 0x22, 0x33, 0x44, 0x55, 0x66, 0x77, 0x88]);
    assert_eq!(bytes[16..24], [0x0a, 0x0b, 0x0c, 0x0d, 0x0e, 0x0f, 0x10, 0x11]);
    assert_eq!(bytes[24..32], [0x80, 0, 0, 0, 0, 0, 0, 2]);
    assert!(bytes[32..64].iter().all(|b| *b == 0xd0) && bytes[64..].iter().all(|b| *b == 0x50));
    assert_eq!(Header::read_from_bytes(bytes).as_ref(), Ok(&header));
}

#[test]
fn class_and_ecn_are_where_ip_has_them() {
    // None of these flags belongs to the three parts that IP has.
    for flags in [0, 0x20, 0x40, 0x80, 0xe0] {
        assert_eq!(Header::ip_traffic(flags), 0);
        assert_eq!(Header::ip_traffic(flags | 5 << 2 | 0b10), 0b1010_0010);
        assert_eq!(Header::ip_traffic(flags | 7 << 2 | Header::CONGESTED), 0b1110_0011);
    }
}

#[test]
fn error_codes_have_places_and_numbers() {
    for (index, code) in ErrorCode::ALL.into_iter().enumerate() {
        assert_eq!((code.index(), ErrorCode::from_number(code as u8)), (index, Some(code)));
    }
    assert_eq!((ErrorCode::from_number(0), ErrorCode::from_number(5)), (None, None));
}

#[test]
fn a_control_frame_is_read_without_its_padding() {
    let mut frame = ControlHeader::new(ControlHeader::QUIC, 3).as_bytes().to_vec();
    frame.extend([1, 2, 3, 0, 0, 0, 0]);
    assert_eq!(ControlHeader::parse(&frame), Some((ControlHeader::QUIC, &[1, 2, 3][..])));
    assert_eq!(ControlHeader::parse(&frame[..10]), None, "truncated");
    assert_eq!(ControlHeader::parse(&frame[..7]), None, "no header");
    frame[0] = FrameType::Data.first_byte();
    assert_eq!(ControlHeader::parse(&frame), None, "another type");
}

/// The tag covers all that switches act on: everything up to the source.
#[test]
fn the_tag_covers_each_bit_that_the_wire_format_says() {
    const KEY: [u64; 2] = [0x0706_0504_0302_0100, 0x0f0e_0d0c_0b0a_0908];
    const COUNT: u64 = 0x1122_3344_5566_7788;
    let header = Header::data(Name::from_bytes([0xd0; 32]), Name::from_bytes([0x50; 32]), 7);
    for bit in 0..Header::LEN * 8 {
        let byte = bit / 8;
        let mut altered = header;
        altered.as_mut_bytes()[byte] ^= 1 << (bit % 8);
        let is_covered = !Header::TAG.contains(&byte) && byte < offset_of!(Header, source);
        assert_eq!(altered.tag_for(KEY, COUNT) == header.tag_for(KEY, COUNT), !is_covered, "bit {bit}");
    }
    for bit in 32..64 {
        assert_ne!(header.tag_for(KEY, COUNT ^ 1 << bit), header.tag_for(KEY, COUNT), "bit {bit} of the count");
    }
}
