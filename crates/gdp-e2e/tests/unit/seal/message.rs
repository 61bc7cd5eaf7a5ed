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
        assert_eq!(&plaintext[preamble.body], b"body");
    }
    assert_eq!(full.preamble_len(), MAX_PREAMBLE);
    // In a bundle they share the timestamp.
    let drafts = [full, Draft { body: b"body", ..full }, plain, Draft { origin: b"x", body: &[9; 300], ..plain }];
    let mut plaintext = 3u64.to_be_bytes().to_vec();
    drafts.iter().for_each(|draft| draft.bundle_into(&mut plaintext));
    assert_eq!(plaintext.len(), 8 + drafts.iter().map(|draft| draft.bundled_len().unwrap()).sum::<usize>());
    let messages = Preamble::parse_bundle(&plaintext, 4).unwrap();
    assert_eq!(messages.iter().map(|message| message.draft(&plaintext)).collect::<Vec<_>>(), drafts);
    assert!(messages.iter().all(|message| message.timestamp_ns == 3));
    for count in [0, 3, 5, 10_918] {
        assert_eq!(Preamble::parse_bundle(&plaintext, count), Err(DropReason::BadMessage), "{count}");
    }
    assert!((0..plaintext.len()).all(|len| Preamble::parse_bundle(&plaintext[..len], 4).is_err()));
    assert_eq!(Draft { body: &[0; 65536], ..plain }.bundled_len(), None);
}

#[test]
fn extensions_of_later_releases_are_skipped_unless_they_are_critical() {
    let plaintext = with_extensions(&[&[0x7f, 0xff, 0, 3, 1, 2, 3], &[0, 2, 0, 1, 9], &[0, 0, 0, 0]]);
    let preamble = Preamble::parse(&plaintext).unwrap();
    assert_eq!((&plaintext[preamble.origin], &plaintext[preamble.body]), (&[9][..], &b"body"[..]));
    for critical in [0x80, 0x81, 0xff] {
        let plaintext = with_extensions(&[&[0, 2, 0, 1, 9], &[critical, 0xff, 0, 3, 1, 2, 3]]);
        assert_eq!(Preamble::parse(&plaintext), Err(DropReason::Unsupported));
    }
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
        assert_eq!(Preamble::parse(&with_extensions(&extensions)), Err(DropReason::BadMessage), "{what}");
    }
    let plaintext = with_extensions(&[&reply]);
    assert!(Preamble::parse(&plaintext).is_ok());
    assert!((0..MESSAGE_HEADER_LEN + 28).all(|len| Preamble::parse(&plaintext[..len]).is_err()));
}

fn with_extensions(extensions: &[&[u8]]) -> Vec<u8> {
    let extensions = extensions.concat();
    let mut plaintext = Draft::new(Encoding::Bytes, b"").preamble(0)[..MESSAGE_HEADER_LEN].to_vec();
    plaintext[10..12].copy_from_slice(&(extensions.len() as u16).to_be_bytes());
    [&plaintext[..], &extensions, b"body"].concat()
}
