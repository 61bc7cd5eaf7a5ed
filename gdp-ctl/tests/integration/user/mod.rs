//! A simulated user at the command line.

use std::process::{Command, Output};

use gdp_tests::programs::own;
use gdp_tests::schema::problems;
use serde_json::Value;

/// Checks a command's output with `-j` against its published schema.
pub fn expect_described(arguments: &[&str], value: &Value) {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/gdp-ctl.schema.json");
    let schema = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let known = |verb: &String| Value::pointer(&schema, &format!("/properties/{verb}")).is_some();
    let verb = [2, 1].map(|words| arguments[..words.min(arguments.len())].join(" ")).into_iter().find(known);
    let verb = verb.unwrap_or_else(|| panic!("{arguments:?} has no schema"));
    assert_eq!(problems(&schema, &format!("/properties/{verb}"), value), [""; 0], "{arguments:?}: {value}");
}

/// A folder in which commands run.
pub struct User {
    pub folder: tempfile::TempDir,
}

impl User {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub fn file(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = own(env!("CARGO_BIN_EXE_gdp-ctl"));
        command.args(arguments).current_dir(self.folder.path()).env("GDP_SOCKET", self.file("ctl.sock"));
        command.env_remove("RUST_LOG").env_remove("RUST_BACKTRACE");
        command
    }

    pub fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    pub fn text(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    pub fn json(&self, arguments: &[&str]) -> Value {
        let text = self.text(&[&["-j"], arguments].concat());
        let value: Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{arguments:?}: {e}: {text}"));
        expect_described(arguments, &value);
        value
    }

    /// Returns the `-j` output of a command that fails with this status.
    pub fn failure(&self, status: i32, arguments: &[&str]) -> Value {
        let output = self.run(&[&["-j"], arguments].concat());
        assert_eq!(output.status.code(), Some(status), "{arguments:?}: {output:?}");
        assert!(!output.stderr.is_empty(), "{arguments:?}: people are told too");
        let value: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {output:?}"));
        expect_described(&["error"], &value);
        value["error"].clone()
    }

    /// Returns the error message of a command that fails with this status.
    pub fn refusal(&self, status: i32, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(status), "{arguments:?}: {error}");
        assert!(output.stdout.is_empty(), "{arguments:?}: an error is not data");
        error
    }

    /// Creates `chatter.card`, owned by `owner.pem`.
    pub fn card(&self, topic: &str) -> Value {
        let create = ["name", "create", "--owner", "owner.pem", "--topic", topic, "--type", "std_msgs/msg/String"];
        self.json(&[&create[..], &["-o", "chatter.card"]].concat())
    }
}
