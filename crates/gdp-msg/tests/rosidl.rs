//! What ROS 2 itself says: its generator of type hashes, also of services and actions, and its
//! Python client of messages, also with wide strings. `rosidl_hashes.txt` is from the `.json` files
//! in the wheels that `definitions/README.md` names; `share/test_msgs`, which has every kind of
//! field, from `ros-test-msgs` 2.3.0; `rclpy_messages.jsonl` is what `rclpy.serialization` of
//! `ros-rclpy` 9.1.2, over `rmw_fastrtps_cpp` 9.3.3, made of random messages of it.

use std::collections::HashSet;
use std::path::Path;

use gdp_msg::{Dialect, Encoding, Mapping, Options, Registry, Schema, TypeName, hash};
use serde_json::Value;

#[test]
fn messages_are_those_of_rclpy() {
    let registry = registry();
    let mut messages = 0;
    for line in include_str!("rclpy_messages.jsonl").lines() {
        let line: Value = serde_json::from_str(line).expect("JSON");
        let name = TypeName::parse(line["type"].as_str().expect("a name")).expect("a name");
        let schema = Schema::resolve(&registry, Dialect::Ros2, &name).expect("a schema");
        let transcode = |from, to, input: &[u8]| {
            let mut output = Vec::new();
            let mapping = Mapping::within(&schema, from, to).expect("a mapping");
            mapping
                .transcode(input, &mut output, &Options::default())
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            output
        };
        let theirs = hex::decode(line["cdr"].as_str().expect("digits")).expect("digits");
        let ours = transcode(Encoding::Json, Encoding::Cdr, line["json"].to_string().as_bytes());
        // Fast CDR leaves in its padding what was there before.
        assert_eq!(hex::encode(transcode(Encoding::Cdr, Encoding::Cdr, &theirs)), hex::encode(&ours), "{name}");
        let json = transcode(Encoding::Cdr, Encoding::Json, &theirs);
        assert_eq!(serde_json::from_slice::<Value>(&json).expect("JSON"), line["json"], "{name}");
        messages += 1;
    }
    assert!(messages > 20, "{messages}");
}

#[test]
fn hashes_of_messages_services_and_actions_are_those_of_rosidl() {
    let registry = registry();
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

/// With `test_msgs`.
fn registry() -> Registry {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/share");
    let mut registry = Registry::embedded();
    let loaded = registry.load_share(Dialect::Ros2, &folder).expect("a share folder");
    assert!(loaded.refused.is_empty(), "{:?}", loaded.refused);
    assert_eq!(loaded.files, 18);
    registry
}
