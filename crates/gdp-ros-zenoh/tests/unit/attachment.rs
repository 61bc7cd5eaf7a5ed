//! Tests of [`super`].

use super::*;

/// What rmw_zenoh_cpp 0.6.7 writes: its first message, at 1 s.
#[test]
fn an_attachment_is_33_bytes_little_endian() {
    let attachment = Attachment { sequence: 1, time_ns: 1_000_000_000, gid: std::array::from_fn(|i| i as u8) };
    let mut bytes = vec![1, 0, 0, 0, 0, 0, 0, 0, 0x00, 0xca, 0x9a, 0x3b, 0, 0, 0, 0, 0x10];
    bytes.extend(0..16);
    assert_eq!(attachment.to_bytes()[..], bytes);
    assert_eq!(Attachment::parse(&bytes), Ok(attachment));
}

#[test]
fn any_other_length_is_refused() {
    for length in (0..80).filter(|length| *length != LENGTH) {
        assert_eq!(Attachment::parse(&vec![0x10; length]), Err(AttachmentError::Length(length)));
    }
    assert_eq!(Attachment::parse(&[0xff; LENGTH]), Err(AttachmentError::Gid(0xff)));
}
