//! ROS 1 masters and rospy nodes. They end with their guards.

use std::fs::File;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use tokio::net::TcpStream;

use crate::PATIENCE;

/// The Python that Debian's rospy is installed for; another may come first in `PATH`.
const PYTHON: &str = "/usr/bin/python3";

pub struct Master {
    _process: Process,
    port: u16,
    folder: tempfile::TempDir,
}

impl Master {
    pub async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        // Free when asked for; taken by the master a moment later.
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut command = Command::new(PYTHON);
        command.args(["/usr/bin/rosmaster", "--core", "-p", &port.to_string()]);
        let process = Process::spawn("rosmaster", command, port, folder.path());
        within("the master takes connections", async {
            while TcpStream::connect(("127.0.0.1", port)).await.is_err() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        })
        .await;
        Self { _process: process, port, folder }
    }

    /// As a configuration says it.
    pub fn graph(&self) -> String {
        format!("{{master: 'http://localhost:{}/', host: localhost}}", self.port)
    }

    /// Starts a rospy node; what it does is in the file.
    pub fn begin(&self, name: &str, arguments: &[&str]) -> Process {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../gdp-ros1/tests/rospy/peer.py");
        let mut command = Command::new(PYTHON);
        command.arg(script).arg(name).args(arguments);
        Process::spawn(name, command, self.port, self.folder.path())
    }
}

pub struct Process {
    name: String,
    child: Child,
    output: PathBuf,
    /// Lines of its output that were looked at.
    seen: usize,
}

impl Process {
    fn spawn(name: &str, mut command: Command, port: u16, folder: &Path) -> Self {
        let output = folder.join(format!("{name}.out"));
        let file = File::create(&output).unwrap();
        command.stdin(Stdio::null()).stdout(file.try_clone().unwrap()).stderr(file);
        command.env("ROS_MASTER_URI", format!("http://localhost:{port}")).env("ROS_HOSTNAME", "localhost");
        command.env_remove("ROS_IP").env("ROS_HOME", folder).env("ROS_LOG_DIR", folder);
        let started = command.spawn();
        let child =
            started.unwrap_or_else(|error| panic!("{PYTHON}: {error}; run `cargo xtask setup`, which installs rospy"));
        Self { name: name.to_owned(), child, output, seen: 0 }
    }

    /// The next of this kind that it says.
    pub async fn event(&mut self, event: &str) -> Value {
        let deadline = tokio::time::Instant::now() + PATIENCE;
        loop {
            let text = std::fs::read_to_string(&self.output).unwrap();
            let complete = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
            for (at, line) in complete.lines().enumerate().skip(self.seen) {
                self.seen = at + 1;
                if let Ok(value) = serde_json::from_str::<Value>(line)
                    && value["event"] == event
                {
                    return value;
                }
            }
            let ended = self.child.try_wait().unwrap();
            assert!(
                ended.is_none() && tokio::time::Instant::now() < deadline,
                "{} said no {event} ({ended:?}):\n{text}",
                self.name
            );
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        _ = self.child.kill();
        _ = self.child.wait();
    }
}

pub async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future).await.unwrap_or_else(|_| panic!("not in {PATIENCE:?}: {what}"))
}
