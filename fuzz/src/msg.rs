//! Definitions of ROS messages, and messages of such types, as they come from a peer or a file.

use std::sync::OnceLock;

use gdp_msg::{Dialect, Encoding, Mapping, Options, Registry, Schema, TypeName};

const ENCODINGS: [Encoding; 4] = [Encoding::Cdr, Encoding::CdrBigEndian, Encoding::Ros1, Encoding::Json];

/// A schema survives its bundle. A message that is taken becomes one of every encoding that is
/// taken as well, and leads back to itself; none becomes larger than the limit, with a prefix in
/// front of its frames or without.
///
/// Input: dialect and encoding in one byte, the length of the definitions in two (big endian), the
/// definitions, the message.
pub fn msg(data: &[u8]) {
    let Some(([options, high, low], rest)) = data.split_first_chunk() else { return };
    let length = usize::from(u16::from_be_bytes([*high, *low])).min(rest.len());
    let (text, message) = rest.split_at(length);
    let Ok(text) = str::from_utf8(text) else { return };
    let dialect = if options & 1 == 0 { Dialect::Ros1 } else { Dialect::Ros2 };
    let from = ENCODINGS[usize::from(options >> 1 & 3)];
    if let Ok(schema) = Schema::from_bundle(text) {
        assert_eq!(Schema::from_bundle(&schema.bundle()).expect("its own bundle"), schema);
    }
    let Ok(schema) = Schema::from_text(dialect, name(), text) else { return };
    assert_eq!(Schema::from_bundle(&schema.bundle()).expect("its own bundle"), schema);
    let limit = Options { max_output: 1 << 16, ..Options::default() };
    let (mut there, mut back, mut again) = (Vec::new(), Vec::new(), Vec::new());
    for to in ENCODINGS {
        let (Ok(mapping), Ok(reverse)) = (Mapping::within(&schema, from, to), Mapping::within(&schema, to, from))
        else {
            return;
        };
        let valid = mapping.validate(message);
        let taken = mapping.transcode(message, &mut there, &limit);
        assert!(taken.is_err() || valid.is_ok() && there.len() <= limit.max_output);
        let framed = Mapping::with_frame_prefix(&schema, from, &schema, to, "robot1/").expect("as many steps");
        assert!(
            framed.transcode(message, &mut again, &limit).is_err() || valid.is_ok() && again.len() <= limit.max_output
        );
        if taken.is_ok() {
            reverse.transcode(&there, &mut back, &Options::default()).expect("its own message");
            mapping.transcode(&back, &mut again, &Options::default()).expect("the message it came from");
            assert_eq!(there, again);
        }
    }
}

fn name() -> &'static TypeName {
    static NAME: OnceLock<TypeName> = OnceLock::new();
    NAME.get_or_init(|| TypeName::parse("fuzz_msgs/Root").expect("a name"))
}

pub fn seeds() -> Vec<(String, Vec<u8>)> {
    const JSON: &str = r#"{"header":{"seq":1,"stamp":{"secs":2,"nsecs":3},"frame_id":"map"},"pose":{"position":{"x":1,"y":2,"z":3},
        "orientation":{"x":0,"y":0,"z":0,"w":"NaN"}}}"#;
    const KINDS: &str =
        "bool b\nint8[2] i\nuint8[] u\nfloat64[<=3] f\nstring<=9 s\nwstring w\nInner[] n\nInner e\nint32 X=5\n";
    const INNER: &str = "===\nMSG: fuzz_msgs/Inner\nuint64 a\nNothing nothing\n===\nMSG: fuzz_msgs/Nothing\n";
    const MESSAGE: &str = r#"{"b":true,"i":[1,-1],"u":"AQID","f":[1e9,"NaN"],"s":"a\né","w":"😀","n":[{"a":"7","nothing":{}}],"e":{"nothing":{},"a":7}}"#;
    let stamped = TypeName::parse("geometry_msgs/PoseStamped").expect("a name");
    let stamped = Schema::resolve(&Registry::embedded(), Dialect::Ros1, &stamped).expect("an embedded type").text();
    let kinds = format!("{KINDS}{INNER}");
    let mut seeds = vec![("a bundle".to_owned(), input(1, &format!("gdp-msg 1 ros2 a/srv/B_Request\n{kinds}"), b""))];
    for (dialect, what, text, json) in [(0, "a pose", &stamped, JSON), (1, "every kind", &kinds, MESSAGE)] {
        let of = if dialect == 0 { Dialect::Ros1 } else { Dialect::Ros2 };
        let schema = Schema::from_text(of, name(), text).expect("a definition");
        for (index, encoding) in ENCODINGS.into_iter().enumerate() {
            let mut message = Vec::new();
            let mapping = Mapping::within(&schema, Encoding::Json, encoding).expect("a mapping");
            mapping.transcode(json.as_bytes(), &mut message, &Options::default()).expect("a message");
            seeds.push((format!("{what} in {encoding}"), input(dialect | (index as u8) << 1, text, &message)));
        }
    }
    seeds
}

fn input(options: u8, text: &str, message: &[u8]) -> Vec<u8> {
    [&[options][..], &(text.len() as u16).to_be_bytes(), text.as_bytes(), message].concat()
}
