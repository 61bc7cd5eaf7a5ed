//! Texts that are definitions, and texts that are none.

mod common;

use common::{Ros1, Ros2, schema};
use gdp_msg::{Base, Count, Dialect, MAX_TEXT, Problem, Registry, Scalar, Schema, SchemaError, TypeName};

#[test]
fn every_kind_of_field_constant_and_default() {
    let text = "\
        # a comment\n\
        int32 X=-12 # another\r\n\
        string S = \"a value\"  # not part of it\n\
        wstring W='ü'\n\
        uint8 H=0xfF\n\
        \n\
        bool flag true\n\
        float32[<=3] bounded [1.0, -2e3,.5]\n\
        string<=5[2] names [\"a,b\", 'c']\n\
        \twstring[]   wide\n\
        time stamp\n\
        Other other\n\
        far_msgs/msg/Thing[3] things\n\
        ================================================================================\n\
        MSG: test_msgs/Other\n\
        ===\n\
        MSG: far_msgs/msg/Thing\n\
        uint8 structure_needs_at_least_one_member\n\
        ===\n\
        MSG: builtin_interfaces/Time\n\
        int32 sec\n\
        uint32 nanosec\n";
    let schema = schema(Ros2, text);
    let root = schema.root();
    let constants: Vec<_> = root.constants.iter().map(|constant| (&*constant.name, &*constant.text)).collect();
    assert_eq!(constants, [("X", "-12"), ("S", "\"a value\""), ("W", "'ü'"), ("H", "0xfF")]);
    let fields: Vec<_> = root.fields.iter().map(|field| (&*field.name, &field.base, field.count)).collect();
    let named = |name: &str| Base::Named(TypeName::parse(name).unwrap());
    let expected = [
        ("flag", &Base::Scalar(Scalar::Bool), Count::One),
        ("bounded", &Base::Scalar(Scalar::Float32), Count::Sequence(Some(3))),
        ("names", &Base::String(Some(5)), Count::Fixed(2)),
        ("wide", &Base::WString(None), Count::Sequence(None)),
        ("stamp", &named("builtin_interfaces/Time"), Count::One),
        ("other", &named("test_msgs/Other"), Count::One),
        ("things", &named("far_msgs/Thing"), Count::Fixed(3)),
    ];
    assert_eq!(fields, expected);
    assert!(schema.definitions().nth(3).is_some_and(|thing| thing.fields.is_empty()));
    assert_eq!(Schema::from_bundle(&schema.bundle()).unwrap(), schema);
}

#[test]
fn ros1_has_time_headers_and_strings_with_hashes() {
    let text = "string PATH=  /a # b \nHeader header\ntime at\nduration[2] spans\nbyte B=-128\n\
                ===\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n";
    let schema = schema(Ros1, text);
    assert_eq!(&*schema.root().constants[0].text, "/a # b");
    assert_eq!(schema.root().fields[2].base, Base::Duration);
    assert_eq!(Schema::from_bundle(&schema.bundle()).unwrap(), schema);
}

#[test]
fn what_is_no_definition_is_refused_with_its_line() {
    type Is = fn(&Problem) -> bool;
    let cases: &[(Dialect, &str, usize, Is)] = &[
        (Ros2, "int32", 1, |p| matches!(p, Problem::Incomplete(_))),
        (Ros2, "\nint32 1x", 2, |p| matches!(p, Problem::Name(_))),
        (Ros2, "int32 a\nint32 a", 2, |p| matches!(p, Problem::Twice(_))),
        (Ros2, "int32[0] a", 1, |p| matches!(p, Problem::Length(_))),
        (Ros2, "int32[99999999999] a", 1, |p| matches!(p, Problem::Length(_))),
        (Ros2, "int32[+3] a", 1, |p| matches!(p, Problem::Length(_))),
        (Ros1, "int32[<=3] a", 1, |p| matches!(p, Problem::Type(..))),
        (Ros1, "string<=3 a", 1, |p| matches!(p, Problem::Type(..))),
        (Ros1, "int32 a 5", 1, |p| matches!(p, Problem::Default(_))),
        (Ros2, "int8 a 128", 1, |p| matches!(p, Problem::Value(..))),
        (Ros2, "int8[2] a [1]", 1, |p| matches!(p, Problem::Value(..))),
        (Ros2, "string<=2 a 'abc'", 1, |p| matches!(p, Problem::Value(..))),
        (Ros2, "bool A=2", 1, |p| matches!(p, Problem::Value(..))),
        (Ros2, "far_msgs/Thing A=2", 1, |p| matches!(p, Problem::Type(..))),
        (Ros2, "a/b/c d", 1, |p| matches!(p, Problem::Type(..))),
        (Ros2, "int32 a\n===\nnonsense", 3, |p| matches!(p, Problem::Header(_))),
        (Ros2, "int32 a\n===\nMSG: no name", 3, |p| matches!(p, Problem::TypeName(_))),
        (Ros2, "int32 a\n===\nIDL: a/msg/B", 3, |p| matches!(p, Problem::Idl)),
        (Ros2, "int32 a\n===\nMSG: a/B\nint32 x\nint32", 5, |p| matches!(p, Problem::Incomplete(_))),
    ];
    for (dialect, text, line, is) in cases {
        let name = TypeName::parse("test_msgs/Root").unwrap();
        let error = match Schema::from_text(*dialect, &name, text) {
            Err(SchemaError::Add(gdp_msg::AddError::Definition(error))) => error,
            other => panic!("{text}: {other:?}"),
        };
        assert!(is(&error.problem) && error.line == *line, "{text}: {error}");
    }
    let parts = Registry::default().add_file(Ros2, &TypeName::parse("a/srv/B").unwrap(), "int32 a");
    assert!(parts.is_err_and(|error| error.to_string().contains("2 parts")));
}

#[test]
fn texts_are_bounded_in_everything() {
    let name = TypeName::parse("test_msgs/Root").unwrap();
    let refused = |text: &str| Schema::from_text(Ros2, &name, text).expect_err("too much");
    refused(&" ".repeat(MAX_TEXT + 1));
    refused(&(0..1025).map(|n| format!("int32 a{n}\n")).collect::<String>());
    refused(&format!("int32 a\n{}", "===\nMSG: a/B\n".repeat(1100)));
    assert!(matches!(refused("Root[] again"), SchemaError::Cycle(_)));
    assert!(matches!(refused("Other a\n===\nMSG: test_msgs/Other\nRoot r"), SchemaError::Cycle(_)));
    assert!(matches!(refused("Other a"), SchemaError::Missing { .. }));
    let nested = |depth: u32| {
        let level = |n| format!("===\nMSG: test_msgs/L{n}\nL{} a\n", n + 1);
        format!("L1 a\n{}===\nMSG: test_msgs/L{depth}\nint32 a", (1..depth).map(level).collect::<String>())
    };
    schema(Ros2, &nested(31));
    assert!(matches!(refused(&nested(32)), SchemaError::TooDeep(_)));
    // The deep ones first, so that they are known when they are met from above.
    assert!(matches!(refused(&format!("L5 b\n{}", nested(40))), SchemaError::TooDeep(_)));
}

#[test]
fn what_is_no_bundle() {
    for text in [
        "",
        "int32 a",
        "gdp-msg 2 ros2 a/B\nint32 a",
        "gdp-msg 1 ros3 a/B\nint32 a",
        "gdp-msg 1 ros2 B\nint32 a",
        "gdp-msg 1",
    ] {
        assert!(Schema::from_bundle(text).is_err(), "{text}");
    }
    assert!(Schema::from_bundle("gdp-msg 1 ros2 a/srv/B_Request").is_ok());
}

#[test]
fn share_folders_of_ros1_services_and_actions() {
    let folder = std::env::temp_dir().join(format!("gdp-msg-{}", std::process::id()));
    let write = |path: &str, text: &[u8]| {
        let file = folder.join(path);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, text).unwrap();
    };
    write("a_msgs/msg/A.msg", b"int32 a\n");
    write("a_msgs/msg/Broken.msg", b"int32\n");
    write("a_msgs/msg/Binary.msg", b"\xff\xfe");
    write("a_msgs/msg/readme.txt", b"int32 a\n");
    write("a_msgs/srv/B.srv", b"A a\n---\nint32 b\n");
    write("a_msgs/action/C.action", b"int32 g\n---\nint32 r\n---\nint32 f\n");
    let mut registry = Registry::embedded();
    let loaded = registry.load_share(Ros1, &folder).unwrap();
    assert!(registry.load_package(Ros1, &folder.join("a_msgs")).is_ok());
    assert!(registry.load_file(Ros1, &folder.join("a_msgs/srv/B.srv")).is_ok());
    assert!(registry.load_file(Ros1, &folder.join("a_msgs/msg/readme.txt")).is_err());
    std::fs::remove_dir_all(&folder).unwrap();
    assert_eq!((loaded.files, loaded.refused.len()), (3, 2), "{:?}", loaded.refused);
    for name in ["a_msgs/srv/B_Request", "a_msgs/CActionGoal", "a_msgs/CAction"] {
        Schema::resolve(&registry, Ros1, &TypeName::parse(name).unwrap()).unwrap();
    }
    assert!(Registry::default().load_share(Ros1, &folder).is_err());
}
