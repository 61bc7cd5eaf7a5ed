//! Unit tests of `node_name`.

use super::*;

#[test]
fn a_node_has_the_prefix_of_what_it_publishes() {
    let here = |local, listed, node| local_node(&TopicName::parse(local).unwrap(), listed, node);
    assert_eq!(here("/robot7/camera", Some("/camera"), "/driver"), "/robot7/driver");
    assert_eq!(here("/camera", Some("/camera"), "/ns/driver"), "/ns/driver");
    assert_eq!(here("/renamed", Some("/camera"), "/driver"), "/driver");
    assert_eq!(here("/camera", None, "/driver"), "/driver");
    assert_eq!(here("/robot7/camera", Some("/camera"), ""), "");
}
