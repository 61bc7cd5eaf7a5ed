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
    let [own_guid, far_guid] = [endpoint(1, 1, false), endpoint(1, 2, true)];
    let own = here.add(own_guid);
    let far = here.add(far_guid);
    far.assign("/robot7/driver");
    let names = || [own_guid, far_guid].map(|guid| there.remote.borrow().node(guid.to_bytes()).to_string());
    assert_eq!(names(), ["", ""]);
    there.take([1; 12], &here.announcement());
    assert_eq!(names(), ["/gdp_proxy_test", "/robot7/driver"]);

    // Nobody can announce the endpoints of others.
    far.assign("/forged");
    there.take([3; 12], &here.announcement());
    assert_eq!(names(), ["/gdp_proxy_test", "/robot7/driver"]);

    far.assign("not a name");
    drop(own);
    there.take([1; 12], &here.announcement());
    assert_eq!(names(), ["", "/gdp_proxy_test"]);
    // It may return without a word.
    there.retain(&HashSet::from([[3; 12]]));
    assert_eq!(names(), ["", "/gdp_proxy_test"]);
    for i in 0..MAX_PARTICIPANTS {
        let mut participant = [9; 12];
        participant[..8].copy_from_slice(&i.to_be_bytes());
        there.take(participant, &[]);
    }
    there.retain(&HashSet::from([[3; 12]]));
    assert_eq!(names(), ["", ""]);
}

#[test]
fn what_is_malformed_is_an_announcement_without_nodes() {
    let (here, there) = (nodes(1), nodes(2));
    let guid = endpoint(1, 1, false);
    let _entry = here.add(guid);
    let whole = here.announcement();
    for length in 0..whole.len() {
        there.take([1; 12], &whole[..length]);
        assert!(there.remote.borrow().has_none(&[1; 12]), "{length} bytes");
    }
    there.take([1; 12], &whole);
    assert!(!there.remote.borrow().has_none(&[1; 12]));
    assert_eq!(&*there.remote.borrow().node(guid.to_bytes()), "/gdp_proxy_test");
}
