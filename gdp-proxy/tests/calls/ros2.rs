//! A DDS domain with rclpy nodes in it.

use std::path::{Path, PathBuf};

use gdp_tests::dds_domain::lease;
use gdp_tests::programs::own;
use tempfile::TempDir;

use crate::master::Process;

pub struct Ros2 {
    id: u16,
    folder: TempDir,
}

impl Ros2 {
    pub fn new() -> Self {
        Self { id: lease(), folder: tempfile::tempdir().unwrap() }
    }

    /// As a configuration says it.
    pub fn graph(&self) -> String {
        format!("{{domain_id: {}}}", self.id)
    }

    /// A node of `peer.py`; returns when it says that it is ready.
    pub async fn peer(&self, name: &str, arguments: &[&str]) -> Process {
        let mut process = self.begin(name, arguments);
        process.event("ready").await;
        process
    }

    /// The same, without waiting.
    pub fn begin(&self, name: &str, arguments: &[&str]) -> Process {
        let python = target().join("venv/bin/python");
        assert!(python.is_file(), "{} does not exist: run `cargo xtask setup`", python.display());
        let mut command = own(python);
        command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/calls/peer.py")).arg(name).args(arguments);
        command.env("ROS_DOMAIN_ID", self.id.to_string());
        Process::spawn(name, command, 0, self.folder.path())
    }
}

/// Cargo's target folder: this test is in `target/PROFILE/deps`.
pub fn target() -> PathBuf {
    std::env::current_exe().unwrap().ancestors().nth(3).unwrap().into()
}
