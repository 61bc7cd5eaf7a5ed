//! What ROS 2's own generator says of type hashes, also of services and actions: `rosidl_hashes.txt` is from the `.json` files in the wheels
//! that `definitions/README.md` names, and `share/test_msgs` from `ros-test-msgs` 2.3.0, which has every kind of field.

use std::collections::HashSet;
use std::path::Path;

use gdp_msg::{Dialect, Registry, Schema, TypeName, hash};

#[test]
fn hashes_of_messages_services_and_actions_are_those_of_rosidl() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/share");
    let mut registry = Registry::embedded();
    let loaded = registry.load_share(Dialect::Ros2, &folder).expect("a share folder");
    assert!(loaded.refused.is_empty(), "{:?}", loaded.refused);
    assert_eq!(loaded.files, 18);
    let mut kinds = HashSet::new();
    for line in include_str!("rosidl_hashes.txt").lines() {
        let (name, expected) = line.split_once(' ').expect("a name and a hash");
        let name = TypeName::parse(name).expect("a name");
        let schema = Schema::resolve(&registry, Dialect::Ros2, &name).expect("a schema");
        assert_eq!(hash::type_hash(&schema), expected, "{name}");
        kinds.insert(name.kind());
    }
    assert_eq!(kinds.len(), 3);
}

/// As `rosmsg md5` and `rossrv md5` of Debian 12 print them.
#[test]
fn md5sums_of_embedded_types_are_those_of_noetic() {
    let registry = Registry::embedded();
    let name = |name: &str| TypeName::parse(name).expect("a name");
    let schema = |name: &TypeName| Schema::resolve(&registry, Dialect::Ros1, name).expect("a schema");
    for (of, expected) in [
        ("std_msgs/Empty", "d41d8cd98f00b204e9800998ecf8427e"),
        ("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1"),
        ("sensor_msgs/PointCloud2", "1158d486dd51d683ce2f1be655c3c181"),
        ("diagnostic_msgs/DiagnosticArray", "60810da900de1dd6ddd437c3503511da"),
        ("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec"),
        ("tf/tfMessage", "94810edda583a504dfda3829e70d7eec"),
    ] {
        assert_eq!(hash::md5sum(&schema(&name(of))), expected, "{of}");
    }
    for (of, expected) in [
        ("std_srvs/Empty", "d41d8cd98f00b204e9800998ecf8427e"),
        ("std_srvs/SetBool", "09fb03525b03e7ea1fd3992bafd87e16"),
        ("std_srvs/Trigger", "937c9679a518e3a18d831e57125ea522"),
        ("nav_msgs/GetMap", "6cdd0a18e0aff5b0a3ca2326a89b54ff"),
    ] {
        let [request, response] = name(of).service_halves().map(|half| schema(&half));
        assert_eq!(hash::service_md5sum(&request, &response), expected, "{of}");
    }
}
