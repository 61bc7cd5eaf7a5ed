use super::*;
use crate::roster::Dialect;

fn description() -> Description {
    let kind = Kind { dialect: Dialect::Ros1, name: "std_srvs/SetBool".into(), hash: vec![7; 16] };
    let definitions = Definitions { request: "bool data\n".into(), response: "bool success\nstring message\n".into() };
    Description { kind, node: "/robot7/driver".into(), definitions: Some(definitions) }
}

fn requests() -> Vec<Request> {
    let (epoch, body) = (Epoch(0x0102_0304_0506_0708), Bytes::from_static(b"\0\x01\0\0goal"));
    let parts = [Part::Service, Part::SendGoal, Part::CancelGoal, Part::GetResult];
    let calls = parts.map(|part| Request::Call { epoch, part, body: body.clone() });
    let cancel = Request::Cancel(MessageId { session: [7; 16], sequence: 9 });
    [Request::Describe, Request::Events { epoch, after: 9 }, cancel].into_iter().chain(calls).collect()
}

fn replies() -> Vec<Reply> {
    let events = vec![Event::Feedback(Bytes::from_static(b"half")), Event::Status(Bytes::new())];
    let mut replies = vec![
        Reply::Description(Epoch(7), description()),
        Reply::Description(Epoch(7), Description { definitions: None, ..description() }),
        Reply::Answer(Bytes::from_static(b"done")),
        Reply::Answer(Bytes::new()),
        Reply::Events(Events { last: 3, dropped: 1, events }),
        Reply::Events(Events::default()),
    ];
    replies.extend(FailureCode::ALL.map(|code| Reply::failure(code, "it is stuck")));
    replies
}

#[test]
fn what_is_said_is_understood() {
    for request in requests() {
        assert_eq!(Request::from_bytes(&request.to_bytes().into()), Ok(request));
    }
    for reply in replies() {
        assert_eq!(Reply::from_bytes(&reply.to_bytes().unwrap().into()), Ok(reply));
    }
}

/// Other implementations rely on them.
#[test]
fn the_bytes_are_those_of_the_documentation() {
    let (epoch, body) = (Epoch(0x0102_0304_0506_0708), Bytes::from_static(b"goal"));
    let request = Request::Call { epoch, part: Part::GetResult, body };
    assert_eq!(request.to_bytes(), b"\x02\x01\x03\x01\x02\x03\x04\x05\x06\x07\x08goal");
    let cancel = Request::Cancel(MessageId { session: *b"0123456789abcdef", sequence: 258 });
    assert_eq!(cancel.to_bytes(), b"\x02\x030123456789abcdef\0\0\0\0\0\0\x01\x02");
    let failure = Reply::failure(FailureCode::Refused, "no");
    assert_eq!(failure.to_bytes().unwrap(), b"\x02\x02\x01no");
    let events = vec![Event::Feedback(Bytes::from_static(b"f")), Event::Status(Bytes::from_static(b"st"))];
    let events = Reply::Events(Events { last: 258, dropped: 0, events });
    let bytes = b"\x02\x03\0\0\0\0\0\0\x01\x02\0\0\0\0\0\0\0\0\0\0\0\0\x01f\x01\0\0\0\x02st";
    assert_eq!(events.to_bytes().unwrap(), bytes);
}

#[test]
fn what_ends_too_early_or_too_late_is_refused() {
    for request in requests().into_iter().filter(|request| !matches!(request, Request::Call { .. })) {
        let bytes = Bytes::from(request.to_bytes());
        for end in 0..bytes.len() {
            assert!(Request::from_bytes(&bytes.slice(..end)).is_err(), "{request:?} to {end}");
        }
        assert!(Request::from_bytes(&[&bytes[..], b"x"].concat().into()).is_err(), "{request:?}");
    }
    let epoch_alone = Bytes::from_static(b"\x02\x01\0\0\0\0\0\0\0\0");
    assert_eq!(Request::from_bytes(&epoch_alone), Err(CallError::Malformed));
    let events = replies().swap_remove(4).to_bytes().unwrap();
    assert_eq!(Reply::from_bytes(&events[..events.len() - 1].to_vec().into()), Err(CallError::Malformed));
}

#[test]
fn what_is_unknown_or_too_much_is_refused() {
    assert_eq!(Request::from_bytes(&Bytes::from_static(b"\x01\0")), Err(CallError::Version(1)));
    for bytes in [&b""[..], b"\x02", b"\x02\x03", b"\x02\x01\x04\0\0\0\0\0\0\0\0"] {
        assert_eq!(Request::from_bytes(&Bytes::from_static(bytes)), Err(CallError::Malformed), "{bytes:?}");
    }
    for bytes in [&b"\x02\x04"[..], b"\x02\x02", b"\x02\x02\x05", b"\x02\x02\0\xff"] {
        assert_eq!(Reply::from_bytes(&Bytes::from_static(bytes)), Err(CallError::Malformed), "{bytes:?}");
    }
    // Lengths that nothing follows cost no memory.
    let claimed = [&b"\x02\x03"[..], &[0; 16], b"\0\xff\xff\xff\xff"].concat();
    assert_eq!(Reply::from_bytes(&claimed.into()), Err(CallError::Malformed));
    let many = Events { events: vec![Event::Status(Bytes::new()); MAX_EVENTS + 1], ..Events::default() };
    let many = Reply::Events(many).to_bytes().unwrap();
    assert!(matches!(Reply::from_bytes(&many.into()), Err(CallError::TooMuch { .. })));
    let long = [&[VERSION, 2, 0][..], &[b'x'; MAX_TEXT + 1]].concat();
    assert!(matches!(Reply::from_bytes(&long.into()), Err(CallError::TooMuch { .. })));
    let long = Definitions { request: "x".repeat(MAX_DEFINITION + 1), response: String::new() };
    let long = Description { definitions: Some(long), ..description() };
    assert!(matches!(Reply::Description(Epoch(1), long).to_bytes(), Err(CallError::TooMuch { .. })));
}

#[test]
fn a_failure_says_what_fits() {
    let failure = Failure::new(FailureCode::Refused, "é".repeat(MAX_TEXT));
    assert_eq!(failure.text().len(), MAX_TEXT);
    let odd = Failure::new(FailureCode::Refused, format!("x{}", "é".repeat(MAX_TEXT)));
    assert_eq!(odd.text().len(), MAX_TEXT - 1);
    assert_eq!(Failure::new(FailureCode::Refused, "it stays on").to_string(), "the server failed: it stays on");
}
