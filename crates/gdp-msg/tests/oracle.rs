//! Every message type of Noetic, Humble and Jazzy, with random contents, against the Python package
//! `rosbags`: definitions, hashes, and the bytes of every encoding.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;

use gdp_msg::{Dialect, Encoding, Mapping, Options, Registry, Schema, TypeName, hash};
use gdp_tests::programs::own;
use serde_json::Value;

const SEED: u32 = 1;
const MESSAGES_PER_TYPE: u32 = 4;

#[test]
fn definitions_hashes_and_bytes_are_those_of_rosbags() {
    let mut types = 0;
    let mut messages = 0;
    let mut embedded = 0;
    let registry = Registry::embedded();
    for_each_case(|case| {
        let case = Case::new(case);
        assert_eq!(hash_of(&case.schema), case.json["hash"], "{}", case.what);
        types += 1;
        if case.json["distribution"] != "humble"
            && let Ok(schema) = Schema::resolve(&registry, case.schema.dialect(), &case.name)
        {
            assert_eq!(hash_of(&schema), case.json["hash"], "{}, embedded", case.what);
            embedded += 1;
        }
        for message in case.json["messages"].as_array().expect("messages") {
            case.encodings(message);
            case.bridged(message);
            messages += 1;
        }
    });
    eprintln!("{types} types, {embedded} of them embedded, {messages} messages");
    // As many as rosbags 0.11.9 has.
    assert_eq!(types, 162 + 150 + 162);
    assert!(embedded > 250, "{embedded}");
}

/// A type.
struct Case {
    json: Value,
    what: String,
    name: TypeName,
    schema: Arc<Schema>,
}

impl Case {
    fn new(json: Value) -> Self {
        let what = format!("{} {}", json["distribution"], json["name"]);
        let name = TypeName::parse(text(&json["name"])).expect("a name");
        let dialect = if json["distribution"] == "noetic" { Dialect::Ros1 } else { Dialect::Ros2 };
        let schema =
            Schema::from_text(dialect, &name, text(&json["text"])).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert_eq!(Schema::from_bundle(&schema.bundle()).expect("its own bundle"), schema);
        Self { json, what, name, schema }
    }

    /// From each encoding to each.
    fn encodings(&self, message: &Value) {
        let all = [
            (Encoding::Cdr, bytes(&message["cdr"])),
            (Encoding::CdrBigEndian, bytes(&message["cdr_big_endian"])),
            (Encoding::Ros1, bytes(&message["ros1"])),
            (Encoding::Json, text(&message["json"]).into()),
        ];
        for (from, input) in &all {
            for (to, expected) in &all {
                let mapping = Mapping::within(&self.schema, *from, *to).expect("a mapping");
                let output = self.transcode(&mapping, input, &format!("{from} to {to}"));
                if *to == Encoding::Json {
                    let parse = |text: &[u8]| serde_json::from_slice::<Value>(text).expect("JSON");
                    assert_eq!(parse(&output), parse(expected), "{} from {from}", self.what);
                } else {
                    assert_eq!(hex::encode(output), hex::encode(expected), "{} from {from} to {to}", self.what);
                }
            }
            Mapping::within(&self.schema, *from, *from).expect("a mapping").validate(input).expect("a message");
        }
    }

    /// Between ROS 2 and the same type in ROS 1, whose headers have a `seq`.
    fn bridged(&self, message: &Value) {
        let Some(ros1_text) = self.json["ros1_text"].as_str() else { return };
        let ros1 = Schema::from_text(Dialect::Ros1, &self.name, ros1_text).expect("a definition");
        let (cdr, bridged) = (bytes(&message["cdr"]), bytes(&message["bridged"]));
        let there = Mapping::new(&self.schema, Encoding::Cdr, &ros1, Encoding::Ros1).expect("a mapping");
        assert_eq!(hex::encode(self.transcode(&there, &cdr, "to ROS 1")), hex::encode(&bridged), "{}", self.what);
        let back = Mapping::new(&ros1, Encoding::Ros1, &self.schema, Encoding::Cdr).expect("a mapping");
        assert_eq!(hex::encode(self.transcode(&back, &bridged, "to ROS 2")), hex::encode(&cdr), "{}", self.what);
        assert!(there.notes().is_empty() && back.notes().is_empty());
    }

    fn transcode(&self, mapping: &Mapping, input: &[u8], way: &str) -> Vec<u8> {
        let mut output = Vec::new();
        let done = mapping.transcode(input, &mut output, &Options::default());
        done.unwrap_or_else(|error| panic!("{}, {way}: {error}", self.what));
        output
    }
}

fn hash_of(schema: &Schema) -> String {
    if schema.dialect() == Dialect::Ros1 { hash::md5sum(schema) } else { hash::type_hash(schema) }
}

fn text(value: &Value) -> &str {
    value.as_str().expect("a text")
}

fn bytes(value: &Value) -> Vec<u8> {
    hex::decode(text(value)).expect("hex digits")
}

/// What `oracle.py` writes.
fn for_each_case(mut each: impl FnMut(Value)) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/oracle.py");
    let mut command = own(python());
    command.arg(script).arg(SEED.to_string()).arg(MESSAGES_PER_TYPE.to_string()).stdout(Stdio::piped());
    let mut oracle = command.spawn().expect("the oracle starts");
    let lines = BufReader::new(oracle.stdout.take().expect("its output")).lines();
    let mut done = false;
    for line in lines {
        let case: Value = serde_json::from_str(&line.expect("a line")).expect("JSON");
        done = case["done"] == true;
        if !done {
            each(case);
        }
    }
    assert!(oracle.wait().expect("its end").success() && done, "the oracle failed: what it printed says why");
}

/// The Python that has rosbags, under the target folder that this test was built in
/// (`target/PROFILE/deps/TEST`).
fn python() -> PathBuf {
    let test = std::env::current_exe().expect("a test");
    let venv = test.ancestors().nth(3).expect("a target folder").join("venv");
    let marker = venv.join("gdp-rosbags-0.11.9");
    assert!(marker.is_file(), "{} does not exist: run `cargo xtask setup`", marker.display());
    venv.join("bin/python")
}
