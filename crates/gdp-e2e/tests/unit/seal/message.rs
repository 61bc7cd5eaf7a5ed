//! Unit tests of `seal::message`.

use super::*;

const REQUEST: MessageId = MessageId { session: [7; 16], sequence: 9 };

#[test]
fn what_is_in_front_of_the_body_round_trips() {
    let latched = Some(Latched { sequence: 4, timestamp_ns: 2 });
    let plain = Draft::new(Encoding::Cdr, b"");
    let service = Some(Name::from_bytes([6; 32]));
    let full = Draft { in_reply_to: Some(REQUEST), origin: &[5; MAX_ORIGIN], latched, service, ..plain };
    for draft in [
        full,
        Draft { in_reply_to: None, ..full },
        Draft { service: None, ..full },
        Draft { origin: b"", ..full },
        Draft { origin: b"x", latched: None, ..full },
    ] {
        let mut plaintext = draft.preamble(3)[..draft.preamble_len()].to_vec();
        plaintext.extend(b"body");
        let preamble = Preamble::parse(&plaintext).unwrap();
        assert_eq!((preamble.timestamp_ns, preamble.encoding), (3, Encoding::Cdr));
        assert_eq!((preamble.in_reply_to, &plaintext[preamble.origin]), (draft.in_reply_to, draft.origin));
        assert_eq!((preamble.latched, preamble.service), (draft.latched, draft.service));
        assert_eq!(&plaintext[preamble.body_at..], b"body");
    }
    assert_eq!(full.preamble_len(), MAX_PREAMBLE);
}

#[test]
fn extensions_of_later_versions_are_skipped() {
    let plaintext = with_extensions(&[&[0x7f, 0xff, 0, 3, 1, 2, 3], &[0, 2, 0, 1, 9], &[0, 0, 0, 0]]);
    let preamble = Preamble::parse(&plaintext).unwrap();
    assert_eq!((&plaintext[preamble.origin], &plaintext[preamble.body_at..]), (&[9][..], &b"body"[..]));
}

#[test]
fn extensions_that_make_no_sense_are_refused() {
    let reply = |len: usize| [&[0, 1, 0, len as u8][..], &[0; 24][..len.min(24)]].concat();
    let latched = |len: usize| [&[0, 3, 0, len as u8][..], &[0; 16][..len]].concat();
    let service = |len: usize| [&[0, 4, 0, len as u8][..], &[0; 33][..len]].concat();
    let (service, short_service, long_service) = (service(32), service(31), service(33));
    let (latched, short_latched) = (latched(16), latched(15));
    let (reply, short, origin) = (reply(24), reply(23), [0, 2, 0, 1, 9]);
    let long_origin = [&[0, 2, 0, 65][..], &[9; 65]].concat();
    for (what, extensions) in [
        ("a value that ends behind the extensions", vec![&[0x7f, 0, 0, 1][..]]),
        ("half a header", vec![&[0, 2, 0]]),
        ("a short identifier", vec![&short]),
        ("two requests", vec![&reply, &reply]),
        ("an empty origin", vec![&[0, 2, 0, 0]]),
        ("a long origin", vec![&long_origin]),
        ("two origins", vec![&origin, &origin]),
        ("half a first sending", vec![&short_latched]),
        ("two first sendings", vec![&latched, &latched]),
        ("a short service", vec![&short_service]),
        ("a long service", vec![&long_service]),
        ("two services", vec![&service, &service]),
    ] {
        assert_eq!(Preamble::parse(&with_extensions(&extensions)), None, "{what}");
    }
    let mut plaintext = with_extensions(&[&reply]);
    assert!(Preamble::parse(&plaintext).is_some());
    assert!((0..MESSAGE_HEADER_LEN + 28).all(|len| Preamble::parse(&plaintext[..len]).is_none()));
    plaintext[15] = 1;
    assert_eq!(Preamble::parse(&plaintext), None, "reserved bytes");
}

fn with_extensions(extensions: &[&[u8]]) -> Vec<u8> {
    let extensions = extensions.concat();
    let mut plaintext = Draft::new(Encoding::Bytes, b"").preamble(0)[..MESSAGE_HEADER_LEN].to_vec();
    plaintext[10..12].copy_from_slice(&(extensions.len() as u16).to_be_bytes());
    [&plaintext[..], &extensions, b"body"].concat()
}
