//! Unit tests of `tcpros::header`.

use super::*;

fn field(text: &[u8]) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text].concat()
}

#[test]
fn a_header_is_what_it_was_and_as_the_wiki_shows_it() {
    let header = Header::new([("topic", "/chatter"), ("message_definition", "string data\n# a=b\n"), ("empty", "")]);
    let bytes = header.encode();
    assert_eq!(u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize, bytes.len() - 4);
    assert_eq!(Header::decode(&bytes[4..]), Ok(header));
    assert_eq!(Header::new([("latching", "1")]).encode(), b"\x0e\0\0\0\x0a\0\0\0latching=1");
}

#[test]
fn hostile_headers_are_refused() {
    assert_eq!(Header::decode(b"\x05\0\0\0a=b"), Err(HeaderError::Truncated));
    assert_eq!(Header::decode(b"\xff\xff\xff\xffa=b"), Err(HeaderError::Truncated));
    assert_eq!(Header::decode(b"\x05\0"), Err(HeaderError::Truncated));
    assert_eq!(Header::decode(&field(b"topic")), Err(HeaderError::NoValue));
    assert_eq!(Header::decode(&field(b"\xff=a")), Err(HeaderError::NotText));
    assert_eq!(Header::decode(&field(b"a=\xb0")), Ok(Header::new([("a", "\u{fffd}")])));
    assert_eq!(Header::decode(&[field(b"a=1"), field(b"a=2")].concat()), Err(HeaderError::Twice("a".to_owned())));
    let many: Vec<u8> = (0..=MAX_FIELDS).flat_map(|i| field(format!("f{i}=").as_bytes())).collect();
    assert_eq!(Header::decode(&many), Err(HeaderError::TooMany));
    assert!(matches!(Header::decode(&vec![0; MAX_HEADER + 1]), Err(HeaderError::TooLong(_))));
}
