//! Unit tests of `store`.

use super::*;

#[test]
fn endpoints_are_read_and_nonsense_is_not() {
    for (text, shown) in [
        ("http://127.0.0.1:2379", "http://127.0.0.1:2379"),
        ("http://etcd-1.lab:80/", "http://etcd-1.lab:80"),
        ("http://[::1]:2379", "http://[::1]:2379"),
        ("https://[::1]:2379/", "https://[::1]:2379"),
    ] {
        assert_eq!(text.parse::<Endpoint>().unwrap().to_string(), shown);
    }
    for text in
        ["", "127.0.0.1:2379", "http://", "http://:2379", "http://a", "http://a:0", "http://a:70000", "http://::1:2379"]
    {
        assert!(text.parse::<Endpoint>().unwrap_err().contains("is not an endpoint"), "{text}");
    }
    for text in
        ["http://a/b:1", "http://a b:1", "http://[a]:1", "http://u:p@a:1", "ftp://a:1", "https://", "https://a:0"]
    {
        assert!(text.parse::<Endpoint>().is_err(), "{text}");
    }
}

#[cfg(not(feature = "etcd"))]
#[test]
fn without_etcd_the_error_names_the_cargo_feature() {
    let endpoint = "http://a:1".parse().unwrap();
    let error = client::EtcdClient::new(&[endpoint], &Access::default()).map(drop).unwrap_err().to_string();
    assert!(error.contains("built without etcd") && error.contains("`etcd`"), "{error}");
}
