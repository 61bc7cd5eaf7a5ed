use serde_json::{Value, json};

use super::*;

#[test]
fn a_file_of_serve_is_read() {
    let file = parse(good().to_string().as_bytes()).expect("a good file");
    assert_eq!(file.data_plane, "xdp-native");
    let folder = tempfile::tempdir().unwrap();
    file.unpack(folder.path()).unwrap();
    assert_eq!(fs::read_to_string(folder.path().join("key.pem")).unwrap(), "text\n");
}

#[test]
fn a_file_that_is_not_of_serve_is_refused_with_the_reason() {
    let with = |change: fn(&mut Value)| {
        let mut value = good();
        change(&mut value);
        value.to_string().into_bytes()
    };
    let cases: [(Vec<u8>, &str); 8] = [
        (
            with(|v| v["version"] = json!(2)),
            "it has version 2, and this tree has 1: use the same commit on both machines",
        ),
        (with(|v| v["switch"] = json!("../x")), "`switch` is not a name of 64 hex digits"),
        (with(|v| v["files"]["../key.pem"] = json!("")), "`files` has further ones"),
        (with(|v| drop(v["files"].as_object_mut().unwrap().remove("key.pem"))), "`files` has no key.pem"),
        (with(|v| v["files"]["key.pem"] = json!("\u{1b}[2J")), "key.pem is not what `gdp-ctl` writes"),
        (with(|v| v["files"]["key.pem"] = json!("a".repeat(10_000))), "key.pem is not what `gdp-ctl` writes"),
        (with(|v| v["\u{1b}[2J"] = json!(1)), "unknown field `?[2J`"),
        (vec![0xff], "expected value"),
    ];
    for (bytes, reason) in cases {
        let error = format!("{:#}", parse(&bytes).err().expect(reason));
        assert!(error.starts_with(reason), "{error}");
    }
}

#[test]
fn text_of_the_edge_cannot_leave_its_line_of_the_report() {
    let mut value = good();
    value["edge"]["kernel"] = json!("6.1\n| 64 B | \u{1b}[31m\u{202e}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.json");
    fs::write(&path, value.to_string()).unwrap();
    let shown = RobotFile::read(&path).unwrap().edge.to_string();
    assert!(shown.starts_with("Linux 6.1?? 64 B ? ?[31m?, a processor"), "{shown}");
}

fn good() -> Value {
    let files: BTreeMap<String, &str> = names().map(|name| (name, "text\n")).collect();
    json!({
        "version": VERSION,
        "switch": "a".repeat(64),
        "edge": {
            "kernel": "6.1", "processor": "a processor", "cores": 2, "interface": "eth0", "driver": "igc",
            "speed": "1000Mb/s", "mtu": 1500,
        },
        "data_plane": "xdp-native",
        "files": files,
    })
}
