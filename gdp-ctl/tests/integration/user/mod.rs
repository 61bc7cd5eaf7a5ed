//! A user at the command line, as tests of it are.

use std::process::{Command, Output};

use gdp_tests::programs::own;
use serde_json::Value;

/// A folder, and commands run in it.
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
        assert_eq!(value["v"], 1, "{arguments:?}");
        value
    }

    /// What a command that fails with this status says of it.
    pub fn refusal(&self, status: i32, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(status), "{arguments:?}: {error}");
        assert!(output.stdout.is_empty(), "{arguments:?}: an error is not data");
        error
    }

    /// Makes `chatter.card`; `owner.pem` is its owner.
    pub fn card(&self, topic: &str) -> Value {
        let create = ["name", "create", "--owner", "owner.pem", "--topic", topic, "--type", "std_msgs/msg/String"];
        self.json(&[&create[..], &["-o", "chatter.card"]].concat())
    }
}
