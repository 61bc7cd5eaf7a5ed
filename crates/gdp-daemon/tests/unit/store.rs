//! Unit tests of `store`.

use super::*;

#[test]
fn endpoints_are_read_and_nonsense_is_not() {
    for (text, shown) in [
        ("http://127.0.0.1:2379", "http://127.0.0.1:2379"),
        ("http://etcd-1.lab:80/", "http://etcd-1.lab:80"),
        ("http://[::1]:2379", "http://[::1]:2379"),
    ] {
        assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), shown);
    }
    for text in
        ["", "127.0.0.1:2379", "http://", "http://:2379", "http://a", "http://a:0", "http://a:70000", "http://::1:2379"]
    {
        assert!(text.parse::<Endpoint>().unwrap_err().contains("is not an endpoint"), "{text}");
    }
    for text in ["http://a/b:1", "http://a b:1", "http://[a]:1", "http://u:p@a:1", "ftp://a:1"] {
        assert!(text.parse::<Endpoint>().is_err(), "{text}");
    }
    assert!("https://a:2379".parse::<Endpoint>().unwrap_err().contains("TLS"));
}
