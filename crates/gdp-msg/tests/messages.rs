//! How messages of one type and encoding become those of another, and what becomes of messages that
//! are none.

mod common;

use common::{Ros1, Ros2, embedded, json_round_trip, mapping, schema, transcode};
use gdp_msg::{Encoding, Fault, MapError, Mapping, Note, Options};

const ENCODINGS: [Encoding; 4] = [Encoding::Cdr, Encoding::CdrBigEndian, Encoding::Ros1, Encoding::Json];

#[test]
fn headers_lose_their_seq_and_get_the_callers() {
    let (ros1, ros2) = (embedded(Ros1, "geometry_msgs/PointStamped"), embedded(Ros2, "geometry_msgs/PointStamped"));
    let json =
        r#"{"header":{"seq":7,"stamp":{"secs":1,"nsecs":2},"frame_id":"map"},"point":{"x":1.0,"y":2.0,"z":3.0}}"#;
    json_round_trip(&ros1, Encoding::Ros1, json);
    let there = transcode(&mapping(&ros1, Encoding::Json, &ros2, Encoding::Json), json).unwrap();
    let ros2_json = json.replace("\"seq\":7,", "").replace("secs", "sec").replace("\"nsec\"", "\"nanosec\"");
    assert_eq!(String::from_utf8(there.clone()).unwrap(), ros2_json);
    let back = mapping(&ros2, Encoding::Json, &ros1, Encoding::Json);
    let mut output = Vec::new();
    back.transcode(&there, &mut output, &Options { header_seq: 9, ..Options::default() }).unwrap();
    assert_eq!(String::from_utf8(output).unwrap(), json.replace("\"seq\":7", "\"seq\":9"));
    assert!(back.notes().is_empty());
}

#[test]
fn times_that_do_not_fit_are_refused() {
    let (ros1, ros2) = (schema(Ros1, "time t\nduration d"), schema(Ros2, TIMES));
    let json = |names: [&str; 2], t: [i64; 2], d: [i64; 2]| {
        let [s, n] = names;
        format!(r#"{{"t":{{"{s}":{},"{n}":{}}},"d":{{"{s}":{},"{n}":{}}}}}"#, t[0], t[1], d[0], d[1])
    };
    let to_ros1 = mapping(&ros2, Encoding::Json, &ros1, Encoding::Ros1);
    let to_ros2 = mapping(&ros1, Encoding::Json, &ros2, Encoding::Cdr);
    let (new, old) = (["sec", "nanosec"], ["secs", "nsecs"]);
    assert!(transcode(&to_ros1, json(new, [i32::MAX.into(), 0], [-5, i32::MAX.into()])).is_ok());
    let error = transcode(&to_ros1, json(new, [-1, 0], [0, 0])).unwrap_err();
    assert_eq!((error.path.as_str(), &error.fault), ("t", &Fault::Range(-1, "uint32")));
    assert!(transcode(&to_ros1, json(new, [0, 0], [0, 1 << 31])).is_err());
    assert!(transcode(&to_ros2, json(old, [i32::MAX.into(), 0], [-5, 0])).is_ok());
    assert!(transcode(&to_ros2, json(old, [1 << 31, 0], [0, 0])).is_err());
    assert!(transcode(&to_ros2, json(old, [0, 0], [0, -1])).is_err());
}

#[test]
fn fields_pair_by_name_by_position_or_not_at_all() {
    let info = [embedded(Ros1, "sensor_msgs/CameraInfo"), embedded(Ros2, "sensor_msgs/CameraInfo")];
    assert!(mapping(&info[0], Encoding::Ros1, &info[1], Encoding::Cdr).notes().is_empty());
    let renamed = mapping(
        &schema(Ros1, "int32 a\nint32 old"),
        Encoding::Json,
        &schema(Ros2, "int32 a\nint32 new"),
        Encoding::Json,
    );
    assert_eq!(transcode(&renamed, r#"{"a":1,"old":2}"#).unwrap(), br#"{"a":1,"new":2}"#);
    let marker = [embedded(Ros1, "visualization_msgs/Marker"), embedded(Ros2, "visualization_msgs/Marker")];
    let notes =
        |from: usize, to: usize| mapping(&marker[from], Encoding::Ros1, &marker[to], Encoding::Cdr).notes().to_vec();
    assert!(notes(0, 1).contains(&Note::Filled("mesh_file".into())));
    assert!(notes(1, 0).contains(&Note::Dropped("uv_coordinates".into())));

    let refused = |from: &str, to: &str| {
        let (from, to) = (schema(Ros1, from), schema(Ros2, to));
        let refusals = ENCODINGS.map(|encoding| Mapping::new(&from, Encoding::Ros1, &to, encoding).unwrap_err());
        assert!(refusals.windows(2).all(|pair| pair[0] == pair[1]));
        refusals[0].clone()
    };
    assert!(matches!(refused("int32 a", "int64 a"), MapError::Type { .. }));
    assert!(matches!(refused("int32 a", "int32[] a"), MapError::Type { .. }));
    assert!(matches!(refused("int32[2] a", "int32[3] a"), MapError::Type { .. }));
    assert!(matches!(refused("uint8 a", "bool a"), MapError::Type { .. }));
    assert!(matches!(refused("string a", "uint8[] a"), MapError::Type { .. }));
    assert!(matches!(refused("int32 a\nint32 b", "int64 c\nint32 b"), MapError::Fields { .. }));
    assert!(matches!(refused("int32 a\nint32 b", "int32 b\nint32 a"), MapError::Order { .. }));
    let other = Mapping::new(
        &embedded(Ros1, "std_msgs/Empty"),
        Encoding::Ros1,
        &embedded(Ros2, "std_msgs/String"),
        Encoding::Cdr,
    );
    assert!(other.unwrap_err().to_string().contains("`data`"));
}

#[test]
fn more_fields_on_one_side() {
    let text = "\n===\nMSG: test_msgs/Inner\nfloat64 x\nstring s\n===\nMSG: test_msgs/Nothing\n";
    let small = schema(Ros2, "uint8 a\nuint8 z");
    let large =
        schema(Ros2, &format!("uint8 a\nInner[] many\nInner[2] two\nNothing n\nwstring w\nuint8[3] o\nuint8 z{text}"));
    let inner = r#"{"x":1.5,"s":"é"}"#;
    let json = format!(r#"{{"a":1,"many":[{inner}],"two":[{inner},{inner}],"n":{{}},"w":"日","o":"AQID","z":9}}"#);
    let zero = r#"{"x":0.0,"s":""}"#;
    let zeros = format!(r#"{{"a":1,"many":[],"two":[{zero},{zero}],"n":{{}},"w":"","o":"AAAA","z":9}}"#);
    for encoding in ENCODINGS {
        let message = transcode(&mapping(&large, Encoding::Json, &large, encoding), &json).unwrap();
        let less = transcode(&mapping(&large, encoding, &small, Encoding::Json), message).unwrap();
        assert_eq!(less, br#"{"a":1,"z":9}"#);
        let more = transcode(&mapping(&small, Encoding::Json, &large, encoding), less).unwrap();
        let back = transcode(&mapping(&large, encoding, &large, Encoding::Json), more).unwrap();
        assert_eq!(String::from_utf8(back).unwrap(), zeros);
    }
}

#[test]
fn wide_text_is_what_vendors_write() {
    let schema = embedded(Ros2, "example_interfaces/WString");
    let bytes = json_round_trip(&schema, Encoding::Cdr, r#"{"data":"ab€😀"}"#);
    // As `rclpy.serialization` over `rmw_fastrtps_cpp` 9.3.3 writes it.
    assert_eq!(hex::encode(bytes), "00010000050000006100000062000000ac2000003dd8000000de0000");
    let narrow = common::embedded(Ros2, "example_interfaces/String");
    for from in ENCODINGS {
        let text = transcode(&mapping(&schema, Encoding::Json, &schema, from), r#"{"data":"ab€😀"}"#).unwrap();
        let text = transcode(&Mapping::new(&schema, from, &schema, Encoding::Json).unwrap(), text).unwrap();
        assert_eq!(String::from_utf8(text).unwrap(), r#"{"data":"ab€😀"}"#);
    }
    let narrowed = transcode(&mapping(&schema, Encoding::Json, &narrow, Encoding::Ros1), r#"{"data":"é"}"#);
    assert_eq!(narrowed.unwrap(), b"\x02\0\0\0\xc3\xa9");
    let lone = [&[0, 1, 0, 0, 1, 0, 0, 0][..], &0xd83d_u32.to_le_bytes()].concat();
    let error = transcode(&mapping(&schema, Encoding::Cdr, &schema, Encoding::Json), lone).unwrap_err();
    assert_eq!(error.fault, Fault::Unicode);
}

#[test]
fn json_keeps_what_rosbridge_loses() {
    let text = "int64 i\nuint64 u\nfloat32 f\nfloat64 d\nfloat64 e\nfloat64[] s\nuint8[] o\nbyte b\nint8[] c\nstring \
                t\nbool[2] l";
    let schema = schema(Ros1, text);
    let json = r#"{"i":"-9223372036854775808","u":9007199254740992,"f":0.1,"d":-0.0,"e":5e-324,"s":["NaN","Infinity","-Infinity",1e+21],"o":"//79","b":-1,"c":[-1,2],"t":"\"\\\n\u0001/é😀","l":[true,false]}"#;
    let bytes = transcode(&mapping(&schema, Encoding::Json, &schema, Encoding::Cdr), json).unwrap();
    for encoding in [Encoding::Cdr, Encoding::Ros1] {
        let parsed = |text: &[u8]| serde_json::from_slice::<serde_json::Value>(text).unwrap();
        let there = transcode(&mapping(&schema, Encoding::Cdr, &schema, encoding), &bytes).unwrap();
        let back = transcode(&mapping(&schema, encoding, &schema, Encoding::Json), there).unwrap();
        assert_eq!(parsed(&back), parsed(json.as_bytes()));
    }
    // Other ways to write the same.
    let other = r#" { "l":[ true , false ], "u":"9007199254740992", "i":"-9223372036854775808", "f":1E-1,"d":-0,"e":5e-324,
        "s":["NaN","Infinity","-Infinity",1000000000000000000000.0],"b":-1,"o":[255,254,253],"c":[-1,2],
        "\u0074":"\u0022\\\n\u0001\/\u00e9\ud83d\ude00" } "#;
    assert_eq!(transcode(&mapping(&schema, Encoding::Json, &schema, Encoding::Cdr), other).unwrap(), bytes);
}

#[test]
fn json_that_is_no_message_is_refused_with_its_place() {
    let schema = schema(Ros2, "Inner[] in\nfloat32 f\n===\nMSG: test_msgs/Inner\nint8 a\nstring<=3 s\nuint8[<=2] o");
    let mapping = mapping(&schema, Encoding::Json, &schema, Encoding::Cdr);
    let inner = r#"{"a":1,"s":"x","o":"AQI="}"#;
    assert!(transcode(&mapping, format!(r#"{{"in":[{inner},{inner}],"f":1}}"#)).is_ok());
    for (bad, path) in [
        (r#"{"a":128,"s":"x","o":""}"#, "in[1].a"),
        (r#"{"a":1.0,"s":"x","o":""}"#, "in[1].a"),
        (r#"{"a":01,"s":"x","o":""}"#, "in[1].a"),
        (r#"{"a":"1","s":"x","o":""}"#, "in[1].a"),
        (r#"{"a":null,"s":"x","o":""}"#, "in[1].a"),
        (r#"{"a":1,"s":5,"o":""}"#, "in[1].s"),
        (r#"{"a":1,"s":"four","o":""}"#, "in[1].s"),
        (r#"{"a":1,"s":"\ud800","o":""}"#, "in[1].s"),
        (r#"{"a":1,"s":"\x","o":""}"#, "in[1].s"),
        ("{\"a\":1,\"s\":\"\n\",\"o\":\"\"}", "in[1].s"),
        (r#"{"a":1,"s":"x","o":"AQID"}"#, "in[1].o"),
        (r#"{"a":1,"s":"x","o":[1,2,3]}"#, "in[1].o"),
        (r#"{"a":1,"s":"x","o":"AQI"}"#, "in[1].o"),
        (r#"{"a":1,"s":"x","o":"","x":1}"#, "in[1]"),
        (r#"{"a":1,"s":"x","o":"","a":1}"#, "in[1]"),
        (r#"{"a":1,"s":"x"}"#, "in[1]"),
        (r#"{"s":"x","a":300,"o":""}"#, "in[1].a"),
        ("[]", "in[1]"),
        ("", "in[1]"),
    ] {
        let error = transcode(&mapping, format!(r#"{{"in":[{inner},{bad}],"f":1}}"#)).expect_err(bad);
        assert_eq!(error.path, path, "{bad}: {error}");
    }
    for whole in
        ["", "{", "[", "nul", r#"{"in":[],"f":1} x"#, r#"{"in":[],"f":1e999}"#, r#"{"in":[,],"f":1}"#, "\u{feff}{}"]
    {
        assert!(transcode(&mapping, whole).is_err(), "{whole}");
    }
    assert!(transcode(&mapping, b"{\"in\":[],\"f\":\xff}").is_err());
    let deep = format!(r#"{{"x":{}"#, "[".repeat(100_000));
    assert!(transcode(&mapping, deep).is_err());
}

#[test]
fn binary_messages_that_are_none_are_refused() {
    let schema = schema(Ros2, "bool b\nInner[] in\nstring s\n===\nMSG: test_msgs/Inner\nint16[] a");
    let json = r#"{"b":true,"in":[{"a":[1,2]},{"a":[]}],"s":"text"}"#;
    for encoding in [Encoding::Cdr, Encoding::CdrBigEndian, Encoding::Ros1] {
        let message = json_round_trip(&schema, encoding, json);
        let mapping = mapping(&schema, encoding, &schema, Encoding::Cdr);
        for length in 0..message.len() {
            assert!(transcode(&mapping, &message[..length]).is_err(), "{encoding}: {length} bytes");
            assert!(mapping.validate(&message[..length]).is_err());
        }
        // Up to three, and one for the empty sequence of two-byte numbers.
        let padding = if encoding == Encoding::Ros1 { 0 } else { 4 };
        for more in 0..8 {
            let longer = [&message[..], &vec![0; more]].concat();
            assert_eq!(transcode(&mapping, longer).is_ok(), more <= padding, "{encoding}: {more} bytes more");
        }
        // Each length in turn claims more than there is.
        let lengths = if encoding == Encoding::Ros1 { [1, 5, 13, 17] } else { [8, 12, 20, 24] };
        for at in lengths {
            let mut claims = message.clone();
            claims[at..at + 4].fill(0xff);
            assert!(matches!(transcode(&mapping, claims).unwrap_err().fault, Fault::Length(_)), "{encoding}: at {at}");
        }
        let mut two = message.clone();
        two[if encoding == Encoding::Ros1 { 0 } else { 4 }] = 2;
        let error = transcode(&mapping, two).unwrap_err();
        assert_eq!((error.path.as_str(), error.fault), ("b", Fault::Bool(2)));
    }
    let mapping = mapping(&schema, Encoding::Cdr, &schema, Encoding::Cdr);
    for head in [[0, 6, 0, 0], [0, 3, 0, 0], [1, 0, 0, 0]] {
        assert!(matches!(transcode(&mapping, head).unwrap_err().fault, Fault::Encapsulation(_)));
    }
    let error = transcode(&mapping, b"\0\x01\0\0\x01\0\0\0\x01\0\0\0\x05\0\0\0").unwrap_err();
    assert_eq!((error.path.as_str(), error.offset, error.fault), ("in[0].a", 16, Fault::Length(5)));
}

#[test]
fn texts_pass_as_they_are_between_binary_encodings_alone() {
    let schema = embedded(Ros1, "std_msgs/String");
    let latin1 = b"\x03\0\0\0a\xe4b";
    let cdr = transcode(&mapping(&schema, Encoding::Ros1, &schema, Encoding::Cdr), latin1).unwrap();
    assert_eq!(cdr, b"\0\x01\0\0\x04\0\0\0a\xe4b\0");
    assert_eq!(transcode(&mapping(&schema, Encoding::Cdr, &schema, Encoding::Ros1), &cdr).unwrap(), latin1);
    let error = transcode(&mapping(&schema, Encoding::Cdr, &schema, Encoding::Json), &cdr).unwrap_err();
    assert_eq!(error.fault, Fault::Unicode);
    let unterminated = transcode(&mapping(&schema, Encoding::Cdr, &schema, Encoding::Ros1), b"\0\x01\0\0\x01\0\0\0a");
    assert_eq!(unterminated.unwrap_err().fault, Fault::Unterminated);
    // What some writers make of an empty text.
    assert_eq!(
        transcode(&mapping(&schema, Encoding::Cdr, &schema, Encoding::Ros1), b"\0\x01\0\0\0\0\0\0").unwrap(),
        [0; 4]
    );
}

#[test]
fn neither_time_nor_memory_beyond_the_input_and_the_limit() {
    let empty = "\n===\nMSG: test_msgs/Nothing\n";
    let nothing = schema(Ros1, &format!("Nothing[] n{empty}"));
    for to in ENCODINGS {
        let mapping = mapping(&nothing, Encoding::Ros1, &nothing, to);
        assert!(transcode(&mapping, 30_000_u32.to_le_bytes()).is_ok());
        assert!(matches!(transcode(&mapping, u32::MAX.to_le_bytes()).unwrap_err().fault, Fault::Nothing(_)));
        assert!(mapping.validate(&u32::MAX.to_le_bytes()).is_err());
    }
    let fixed = schema(Ros1, &format!("Many[60000000] m\n===\nMSG: test_msgs/Many\nNothing[60000000] n{empty}"));
    assert!(mapping(&fixed, Encoding::Ros1, &fixed, Encoding::Ros1).validate(b"").is_err());
    // Two fields of the next type in each of 31: no program has room for all of them.
    let level = |n| format!("===\nMSG: test_msgs/L{n}\nL{0} a\nL{0} b\n", n + 1);
    let broad = format!("L1 a\n{}===\nMSG: test_msgs/L30\nstring a", (1..30).map(level).collect::<String>());
    let broad = schema(Ros2, &broad);
    assert!(matches!(Mapping::within(&broad, Encoding::Cdr, Encoding::Json), Err(MapError::TooLarge(_))));
    // What is filled in is bounded by the limit.
    let (small, large) = (schema(Ros1, "uint8 a"), schema(Ros1, "uint8 a\nfloat64[60000000] f"));
    for to in ENCODINGS {
        let mapping = mapping(&small, Encoding::Ros1, &large, to);
        let mut output = Vec::new();
        let options = Options { max_output: 10_000, ..Options::default() };
        assert_eq!(mapping.transcode(&[1], &mut output, &options).unwrap_err().fault, Fault::Output(10_000));
        assert!(output.capacity() <= 20_000);
        assert!(mapping.validate(&[1]).is_ok());
    }
    // JSON is larger than what it is made of, and stays below the limit, too.
    let floats = schema(Ros2, "float64[] f");
    let message = [&[0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0][..], &[0xfe; 2048]].concat();
    let to_json = mapping(&floats, Encoding::Cdr, &floats, Encoding::Json);
    let mut output = Vec::new();
    assert!(to_json.transcode(&message, &mut output, &Options { max_output: 5_000, ..Options::default() }).is_err());
    assert!(to_json.transcode(&message, &mut output, &Options { max_output: 10_000, ..Options::default() }).is_ok());
}

const TIMES: &str = "builtin_interfaces/Time t\nbuiltin_interfaces/Duration d\n===\nMSG: \
                     builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n\
                     ===\nMSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n";
