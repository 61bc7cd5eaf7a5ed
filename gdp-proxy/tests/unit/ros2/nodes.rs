//! Unit tests of `ros2::nodes`.

use super::*;

fn endpoint(participant: u8, key: u8, is_writer: bool) -> GUID {
    let mut bytes = [participant; 16];
    bytes[12..].copy_from_slice(&[0, 0, key, if is_writer { 0x03 } else { 0x04 }]);
    GUID::from_bytes(bytes)
}

fn nodes(participant: u8) -> Arc<Nodes> {
    Arc::new(Nodes::new(endpoint(participant, 0, true), NodeName::new("/", "gdp_proxy_test").unwrap()))
}

#[test]
fn endpoints_are_announced_under_their_nodes_and_read_back() {
    let (here, there) = (nodes(1), nodes(2));
    let own = here.add(endpoint(1, 1, false));
    let far = here.add(endpoint(1, 2, true));
    far.assign("/robot7/driver");
    there.take([1; 12], &here.announcement());
    let names = |of: &Nodes| {
        let mut names: Vec<_> = of.remote.borrow().values().map(|name| name.to_string()).collect();
        names.sort();
        names
    };
    assert_eq!(names(&there), ["/gdp_proxy_test", "/robot7/driver"]);

    // Nobody can announce the endpoints of others.
    there.take([3; 12], &here.announcement());
    assert_eq!(names(&there), ["/gdp_proxy_test", "/robot7/driver"]);

    far.assign("not a name");
    drop(own);
    there.take([1; 12], &here.announcement());
    assert_eq!(names(&there), ["/gdp_proxy_test"]);
    there.retain(&HashSet::from([[3; 12]]));
    assert_eq!(names(&there), [""; 0]);
}

#[test]
fn what_is_malformed_changes_nothing() {
    let (here, there) = (nodes(1), nodes(2));
    let _entry = here.add(endpoint(1, 1, false));
    let whole = here.announcement();
    for length in 0..whole.len() {
        there.take([1; 12], &whole[..length]);
        assert!(there.remote.borrow().is_empty(), "{length} bytes");
    }
    there.take([1; 12], &whole);
    assert_eq!(there.remote.borrow().len(), 1);
}
