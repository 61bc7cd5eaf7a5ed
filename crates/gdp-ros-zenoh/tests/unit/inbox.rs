//! Tests of [`super`].

use super::*;

#[test]
fn payloads_have_the_header_of_cdr() {
    let bytes = |bytes: &[u8]| cdr(&ZBytes::from(bytes)).map(|bytes| bytes.len());
    assert_eq!(bytes(&[0, 1, 0, 0, 5]), Ok(5));
    assert_eq!(bytes(&[0, 0, 0, 3]), Ok(4));
    for broken in [&[][..], &[0, 1, 0], &[0, 7, 0, 0, 1], &[1, 1, 0, 0]] {
        assert_eq!(bytes(broken), Err(MessageError::Malformed));
    }
}

#[test]
fn attachments_are_checked_before_they_are_read() {
    assert_eq!(attachment(None), Err(AttachmentError::Missing));
    assert_eq!(attachment(Some(&ZBytes::from(&[0; 5][..]))), Err(AttachmentError::Length(5)));
    assert_eq!(attachment(Some(&ZBytes::from(&[0; 33][..]))), Err(AttachmentError::Gid(0)));
}
