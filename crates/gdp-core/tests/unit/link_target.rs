//! Unit tests of `link_target`.

use super::*;

#[test]
fn targets_survive_their_text() {
    for text in [
        "eth://r0",
        "eth://r0/02:00:00:00:00:01",
        "udp://127.0.0.1:31415",
        "udp://[::1]:9",
        "udp://edge.local:1",
        "udp://edge.local:1%wwan0",
        "udp://[::1]:9%wlan0",
        "tls://edge.local:443",
        "tls://[::1]:8443",
        "wss://192.0.2.1:443",
    ] {
        assert_eq!(text.parse::<LinkTarget>().unwrap().to_string(), text);
    }
    assert_eq!("udp://edge".parse::<LinkTarget>().unwrap().to_string(), "udp://edge:31415");
    assert_eq!("tls://edge".parse::<LinkTarget>().unwrap().to_string(), "tls://edge:443");
    assert_eq!("wss://[::1]".parse::<LinkTarget>().unwrap().to_string(), "wss://[::1]:443");
}

#[test]
fn anything_else_is_refused() {
    for text in [
        "",
        "r0",
        "eth://",
        "eth:///02:00:00:00:00:01",
        "eth://r0/02",
        "eth://an-interface-too-long",
        "udp://",
        "udp://:1",
        "udp://host:",
        "udp://host:0",
        "udp://host:65536",
        "udp://::1",
        "udp://[::1",
        "udp://[host]:1",
        "udp://a/b",
        "udp://a%",
        "udp://a%w/0",
        "udp://a%an-interface-too-long",
        "tcp://host:1",
        "tls://",
        "tls://host:0",
        "wss://host/path",
        "wss://host:443%wlan0",
    ] {
        assert!(text.parse::<LinkTarget>().is_err(), "{text}");
    }
}

#[test]
fn an_address_without_its_scheme_is_understood() {
    for (text, meant) in [
        ("127.0.0.1:31415", Some("udp://127.0.0.1:31415")),
        ("edge.local", Some("udp://edge.local:31415")),
        ("[::1]:9", Some("udp://[::1]:9")),
        ("tcp://edge:9", Some("udp://edge:9")),
        ("udp://:1", None),
        ("wlan0", None),
        ("udp:edge", None),
    ] {
        let error = text.parse::<LinkTarget>().unwrap_err().to_string();
        let hint = meant.map(|meant| format!("is no link: did you mean {meant}?"));
        assert!(hint.map_or(error.contains("is no link: expected eth://"), |hint| error.ends_with(&hint)), "{error}");
    }
}
