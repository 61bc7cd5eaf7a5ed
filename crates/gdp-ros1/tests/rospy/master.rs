//! A real master and real rospy nodes. They end with their guards, and if the test is killed with
//! the thread that started them.

use std::fs::File;
use std::net::TcpListener;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};
use std::time::Duration;

use gdp_ros1::{Node, NodeConfig};
use gdp_tests::programs::{Executable as _, Program};
use serde_json::Value;
use tempfile::TempDir;
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep};

/// For whatever a test waits for. Says that it is broken, not how fast it is.
pub const LIMIT: Duration = Duration::from_secs(60);

/// A master, and a folder for what it and its nodes write.
pub struct Master {
    process: Process,
    port: u16,
    folder: TempDir,
}

impl Master {
    pub async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port = free_port();
        let process = Self::process(port, folder.path()).await;
        Self { process, port, folder }
    }

    /// As after a crash.
    pub fn kill(&mut self) {
        self.process.kill();
    }

    /// At the same address, knowing nothing.
    pub async fn restart(&mut self) {
        self.process = Self::process(self.port, self.folder.path()).await;
    }

    async fn process(port: u16, folder: &Path) -> Process {
        let mut command = Program::Python3.command();
        command.args([Program::Rosmaster.name(), "--core", "-p", &port.to_string()]);
        let mut process = Process::spawn("rosmaster", command, port, folder);
        process.until("it takes connections", async || TcpStream::connect(("127.0.0.1", port)).await.ok()).await;
        process
    }

    pub fn config(&self, name: &str) -> NodeConfig {
        let uri = format!("http://localhost:{}/", self.port);
        let variable = |variable: &str| match variable {
            "ROS_MASTER_URI" => Some(uri.clone()),
            "ROS_HOSTNAME" => Some("localhost".to_owned()),
            _ => None,
        };
        let poll = Duration::from_millis(200);
        NodeConfig { poll, ..NodeConfig::from_variables(name, variable, "") }
    }

    /// A node of ours.
    pub async fn node(&self, name: &str) -> Node {
        Node::start(self.config(name)).await.unwrap()
    }

    /// A rospy node of the same name as its folder; returns when it says that it is ready, with
    /// what it says.
    pub async fn peer(&self, name: &str, arguments: &[&str]) -> (Process, Value) {
        let mut process = self.begin(name, arguments);
        let ready = process.event("ready").await;
        (process, ready)
    }

    /// The same, without waiting.
    pub fn begin(&self, name: &str, arguments: &[&str]) -> Process {
        // Tests of other crates include this file, too.
        let above = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
        let peer = above.map(|folder| folder.join("crates/gdp-ros1/tests/rospy/peer.py")).find(|file| file.is_file());
        let mut command = Program::Python3.command();
        command.arg(peer.expect("peer.py lies in the working copy")).arg(name).args(arguments);
        self.spawn(name, command)
    }

    /// Another program that is a node.
    pub fn spawn(&self, name: &str, command: Command) -> Process {
        Process::spawn(name, command, self.port, self.folder.path())
    }
}

/// For a server that is started and started again. Below those that the system gives to outgoing
/// connections: one of these could take it in between.
fn free_port() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let first = 12_000 + std::process::id() % 16_000;
    let mut ports = std::iter::from_fn(|| Some(first as u16 + NEXT.fetch_add(1, Ordering::Relaxed)));
    ports.find(|&port| TcpListener::bind(("127.0.0.1", port)).is_ok()).unwrap()
}

/// A running program.
pub struct Process {
    name: String,
    child: Child,
    output: std::path::PathBuf,
    /// Lines of its output that were looked at.
    seen: usize,
}

impl Process {
    /// Of a master at this port. What it prints goes to the folder.
    pub fn spawn(name: &str, mut command: Command, port: u16, folder: &Path) -> Self {
        let output = folder.join(format!("{name}.out"));
        let file = File::create(&output).unwrap();
        command.stdin(Stdio::null()).stdout(file.try_clone().unwrap()).stderr(file);
        command.env("ROS_MASTER_URI", format!("http://localhost:{port}")).env("ROS_HOSTNAME", "localhost");
        command.env_remove("ROS_IP").env("ROS_HOME", folder).env("ROS_LOG_DIR", folder);
        // SAFETY: prctl is async-signal-safe and touches no memory of ours.
        unsafe {
            command.pre_exec(|| match libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) {
                0 => Ok(()),
                _ => Err(std::io::Error::last_os_error()),
            });
        }
        let child = command.spawn().unwrap_or_else(|error| panic!("{name}: {error}\n{INSTALL}"));
        Self { name: name.to_owned(), child, output, seen: 0 }
    }

    /// Without a chance to say goodbye.
    pub fn kill(&mut self) {
        // It may have ended already.
        _ = self.child.kill();
        self.child.wait().unwrap();
    }

    pub fn signal(&self, signal: i32) {
        // SAFETY: no memory is involved; the child is not reaped yet, so this is its number.
        assert_eq!(unsafe { libc::kill(self.child.id() as i32, signal) }, 0);
    }

    /// As Ctrl-C does it: it takes leave of the master, and ends.
    pub async fn stop(&mut self) {
        self.signal(libc::SIGINT);
        until(&format!("{} ends", self.name), async || self.child.try_wait().unwrap()).await;
    }

    /// The next of this kind that it says.
    pub async fn event(&mut self, event: &str) -> Value {
        let (output, mut seen) = (self.output.clone(), self.seen);
        let found = self.until(event, async || {
            let text = std::fs::read_to_string(&output).unwrap();
            let complete = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
            let mut lines = complete.lines().enumerate().skip(seen);
            lines.find_map(|(at, line)| {
                let value: Value = serde_json::from_str(line).ok()?;
                seen = at + 1;
                (value["event"] == event).then_some(value)
            })
        });
        let found = found.await;
        self.seen = seen;
        found
    }

    /// Waits for what it is to do; shows what it printed if that does not come.
    async fn until<T>(&mut self, what: &str, mut condition: impl AsyncFnMut() -> Option<T>) -> T {
        let deadline = Instant::now() + LIMIT;
        loop {
            // Asked before: what it did before it ended counts.
            let ended = self.child.try_wait().unwrap();
            if let Some(value) = condition().await {
                return value;
            }
            if ended.is_some() || Instant::now() > deadline {
                let output = std::fs::read_to_string(&self.output).unwrap_or_default();
                panic!("{}: not {what:?} (ended: {ended:?})\n{output}\n{INSTALL}", self.name);
            }
            sleep(Duration::from_millis(20)).await;
        }
    }
}

const INSTALL: &str =
    "These tests need rosmaster and rospy from Debian, and some rclpy: `cargo xtask setup` installs them.";

impl Drop for Process {
    fn drop(&mut self) {
        _ = self.child.kill();
        _ = self.child.wait();
    }
}

/// Waits for a condition, and panics if it does not come true.
pub async fn until<T>(what: &str, mut condition: impl AsyncFnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + LIMIT;
    loop {
        if let Some(value) = condition().await {
            return value;
        }
        assert!(Instant::now() < deadline, "in vain: {what}");
        sleep(Duration::from_millis(20)).await;
    }
}
