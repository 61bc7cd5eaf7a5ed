//! Unit tests of `admin`.

use super::*;

#[test]
fn requests_and_replies_survive_their_line() {
    let after = Some(Name::from_bytes([7; 32]));
    for request in [Request::Status, Request::Fib { after }, Request::Rib { after: None }] {
        let mut value = serde_json::to_value(&request).unwrap();
        value["v"] = VERSION.into();
        let parsed = parse_request(value.to_string().as_bytes()).unwrap();
        assert_eq!(format!("{parsed:?}"), format!("{request:?}"));
    }
    let line = reply_line(&Reply::Control(Response::Attached { serial: 9 }));
    assert_eq!(line, "{\"v\":2,\"control\":{\"Attached\":{\"serial\":9}}}\n");
}

#[test]
fn what_is_not_a_request_is_named() {
    for (line, needle) in [
        ("", "not JSON"),
        ("[]", "not a JSON object"),
        ("{\"op\":\"status\"}", "\"v\": 2 is missing"),
        ("{\"v\":1,\"op\":\"status\"}", "version 1"),
        ("{\"v\":2,\"op\":\"reboot\"}", "reboot"),
        ("{\"v\":2,\"op\":\"fib\",\"after\":\"75e\"}", "64 hex digits"),
    ] {
        let error = parse_request(line.as_bytes()).expect_err(line);
        assert!(error.contains(needle), "{line}: {error}");
    }
}
