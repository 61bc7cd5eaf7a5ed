//! Unit tests of `api::client`.

use super::*;

#[test]
fn uris_of_ros_are_taken_apart() {
    let parts = |uri: &str| {
        let uri: Uri = uri.parse().ok()?;
        host_and_port(&uri).map(|(host, port)| (host.to_owned(), port))
    };
    assert_eq!(parts("http://robot:11311/"), Some(("robot".to_owned(), 11311)));
    assert_eq!(parts("http://[::1]:80"), Some(("::1".to_owned(), 80)));
    assert_eq!(parts("rosrpc://10.0.0.1:40000"), Some(("10.0.0.1".to_owned(), 40000)));
    for bad in ["http://robot", "file:///etc", "https://robot:1/", "/a", "http://robot:99999/"] {
        assert_eq!(parts(bad), None, "{bad}");
    }
}
