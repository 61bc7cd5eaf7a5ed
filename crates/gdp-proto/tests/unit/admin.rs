//! Unit tests of `admin`.

use super::*;

#[test]
fn requests_and_replies_survive_their_line() {
    let after = Some(Name::from_bytes([7; 32]));
    for request in [Request::Status, Request::Fib { after }, Request::Rib { after: None }] {
        let mut value = serde_json::to_value(&request).unwrap();
        value["v"] = 1.into();
        let parsed = parse_request(value.to_string().as_bytes()).unwrap();
        assert_eq!(format!("{parsed:?}"), format!("{request:?}"));
    }
    let line = reply_line(&Reply::Control(Response::Attached { serial: 9 }));
    assert_eq!(line, "{\"v\":1,\"control\":{\"Attached\":{\"serial\":9}}}\n");
}

#[test]
fn what_is_not_a_request_is_named() {
    for (line, needle) in [
        ("", "not JSON"),
        ("[]", "not a JSON object"),
        ("{\"op\":\"status\"}", "\"v\": 1 is missing"),
        ("{\"v\":2,\"op\":\"status\"}", "version 2"),
        ("{\"v\":1,\"op\":\"reboot\"}", "reboot"),
        ("{\"v\":1,\"op\":\"fib\",\"after\":\"75e\"}", "64 hex digits"),
    ] {
        let error = parse_request(line.as_bytes()).expect_err(line);
        assert!(error.contains(needle), "{line}: {error}");
    }
}
