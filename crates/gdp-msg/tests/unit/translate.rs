//! Unit tests of `translate`.

use super::*;
use crate::{Encoding, Mapping, Options};

const STATUS: &str = "Header header\ntime stamp\nbyte level\nuint8 BAD=2\nPart[] parts\n\
    ================================================================================\n\
    MSG: my_robot/Part\nstring name\nduration age\nfloat64[3] at\n";

#[test]
fn a_type_that_nobody_knows_crosses_there_and_back() {
    let (known, name) = (Registry::embedded(), TypeName::parse("my_robot/Status").unwrap());
    let ros1 = {
        let mut registry = known.clone();
        registry.add_text(Dialect::Ros1, &name, STATUS).unwrap();
        Schema::resolve(&registry, Dialect::Ros1, &name).unwrap()
    };
    let ros2 = ros1.in_dialect(Dialect::Ros2, &known).unwrap();
    assert!(ros2.text().starts_with(
        "uint8 BAD=2\nstd_msgs/Header header\nbuiltin_interfaces/Time stamp\nint8 level\nmy_robot/Part[] parts\n"
    ));
    let back = ros2.in_dialect(Dialect::Ros1, &known).unwrap();
    assert_eq!(back.text(), ros1.text().replace("byte level", "int8 level"));

    let (there, here) = (
        Mapping::new(&ros1, Encoding::Ros1, &ros2, Encoding::Cdr).unwrap(),
        Mapping::new(&ros2, Encoding::Cdr, &ros1, Encoding::Ros1).unwrap(),
    );
    let json = Mapping::within(&ros1, Encoding::Json, Encoding::Ros1).unwrap();
    let text =
        br#"{"header":{"seq":0,"stamp":{"secs":1,"nsecs":2},"frame_id":"map"},"stamp":{"secs":3,"nsecs":4},"level":-5,
        "parts":[{"name":"arm","age":{"secs":-1,"nsecs":6},"at":[1.5,2,3]}]}"#;
    let (mut message, mut cdr, mut again) = (Vec::new(), Vec::new(), Vec::new());
    json.transcode(text, &mut message, &Options::default()).unwrap();
    there.transcode(&message, &mut cdr, &Options::default()).unwrap();
    here.transcode(&cdr, &mut again, &Options::default()).unwrap();
    assert_eq!(again, message);
}

#[test]
fn what_ros_1_does_not_have_becomes_what_it_has() {
    let name = TypeName::parse("my_robot/Bounded").unwrap();
    let text = "string<=10 a\nint32[<=3] b\nbyte c\nchar d 7\n";
    let ros2 = Schema::from_text(Dialect::Ros2, &name, text).unwrap();
    let ros1 = ros2.in_dialect(Dialect::Ros1, &Registry::default()).unwrap();
    assert_eq!(ros1.text(), "string a\nint32[] b\nuint8 c\nuint8 d\n");
    assert_eq!(ros2.in_dialect(Dialect::Ros2, &Registry::default()).unwrap().text(), ros2.text());
}
