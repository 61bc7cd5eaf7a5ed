//! The programs of `bench calls`: a switch, three servers and one client. Each is beside its proxy,
//! and all are on loopback.

use std::fs;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::Tools;
use gdp_tests::process::Process;
use gdp_tests::programs::own;
use gdp_tests::wait::TIMEOUT;
use serde_json::Value;

use crate::workspace;

/// DDS domain of the client. The servers have the following ones.
const DOMAIN: u16 = 92;

const SERVERS: u16 = 3;
const SERVICE: &str = "/switch";

pub struct Site {
    proxy: PathBuf,
    link: String,
    servers: Vec<Process>,
    // These end after the servers.
    _proxies: Vec<Process>,
    _switch: Process,
    folder: tempfile::TempDir,
}

impl Site {
    pub fn start(tools: &Tools) -> Result<Self> {
        let folder = tempfile::Builder::new().prefix("gdp-bench-").tempdir()?;
        let (ctl, proxy) = (tools.gdp_ctl()?, tools.gdp_proxy()?);
        let ctl = |line: &str| command(&ctl, line, folder.path());
        // The port may be taken meanwhile; then the switch does not start and says so.
        let port = UdpSocket::bind("127.0.0.1:0")?.local_addr()?.port();
        let serve = format!("serve --identity hub.pem --socket hub.sock --udp 127.0.0.1:{port} --data-plane userspace");
        let switch = Process::spawn("switch", ctl(&serve), folder.path())?;
        let link = format!("udp://127.0.0.1:{port}");
        output(ctl("key generate owner.pem --kind owner"))?;
        let create =
            format!("name create --owner owner.pem --kind service --type std_srvs/srv/SetBool --topic {SERVICE}");
        output(ctl(&format!("{create} --idempotent -o card")))?;
        let grant = |label: &str, right: &str, file: &str| {
            let shown = output(ctl(&format!("key generate {label}.pem --kind proxy --json")))?;
            let name = shown["name"].as_str().context("a key without a name")?.to_owned();
            output(ctl(&format!("grant add card --key owner.pem --entity {name} {right} -o {file}")))
        };
        grant("client", "--read", "client.grant")?;
        let (mut proxies, mut servers) = (Vec::new(), Vec::new());
        for number in 1..=SERVERS {
            let label = format!("server{number}");
            grant(&label, "--publish", &format!("{label}.ad"))?;
            let entry = format!("direction: out, cert: {label}.ad");
            proxies.push(start_proxy(&proxy, &label, DOMAIN + number, &link, &entry, folder.path())?);
            let mut server = peer(&label, DOMAIN + number, &["serve", SERVICE, &number.to_string()], folder.path())?;
            server.wait_event("ready", TIMEOUT)?;
            servers.push(server);
        }
        Ok(Self { proxy, link, servers, _proxies: proxies, _switch: switch, folder })
    }

    /// Returns the index of the server that a single call goes to.
    pub fn nearest(&mut self) -> Result<usize> {
        let done = self.call(1, 1, 1, (0, Duration::ZERO))?;
        let labels = done["labels"].as_object().context("labels")?;
        let label = labels.keys().next().context("no server has answered")?;
        Ok(label.parse::<usize>()? - 1)
    }

    /// Measures so many calls per second to `copies` servers. Meanwhile one server is stalled for a
    /// part of each second. Returns the time of each answered call.
    pub fn measure(&mut self, copies: u8, count: u32, rate: u32, stalled: (usize, Duration)) -> Result<Vec<Duration>> {
        let done = self.call(copies, count, rate, stalled)?;
        let taken = done["taken_us"].as_array().context("taken_us")?;
        Ok(taken.iter().filter_map(Value::as_u64).map(Duration::from_micros).collect())
    }

    fn call(&mut self, copies: u8, count: u32, rate: u32, (nearest, stall): (usize, Duration)) -> Result<Value> {
        let replicate = if copies > 1 { format!(", replicate: {copies}") } else { String::new() };
        let entry = format!("direction: in, grant: client.grant{replicate}");
        let folder = self.folder.path();
        let mut proxy = start_proxy(&self.proxy, "client", DOMAIN, &self.link, &entry, folder)?;
        let stats = folder.join("client.json");
        proxy.wait_until("all servers can be called", TIMEOUT, |_| {
            let stats: Value = serde_json::from_slice(&fs::read(&stats).ok()?).ok()?;
            (stats["calls"][0]["servers"] == SERVERS).then_some(())
        })?;
        let arguments = ["call", SERVICE, &count.to_string(), &rate.to_string()];
        let mut client = peer("client-node", DOMAIN, &arguments, folder)?;
        let stalling = Stalling { server: self.servers[nearest].pid(), stall };
        let limit = Instant::now() + Duration::from_secs(u64::from(count.div_ceil(rate))) + TIMEOUT;
        loop {
            client.check_alive()?;
            if let Some(done) = client.json_lines().into_iter().find(|line| line["event"] == "done") {
                return Ok(done);
            }
            ensure!(Instant::now() < limit, "the client did not end\n{}", client.report());
            gdp_tests::wait::check_interrupt()?;
            stalling.one_second()?;
        }
    }
}

/// Stops a program for a part of each second. It runs again when this is dropped.
struct Stalling {
    server: u32,
    stall: Duration,
}

impl Stalling {
    fn one_second(&self) -> Result<()> {
        if !self.stall.is_zero() {
            self.signal(libc::SIGSTOP)?;
            std::thread::sleep(self.stall);
            self.signal(libc::SIGCONT)?;
        }
        std::thread::sleep(Duration::from_secs(1).saturating_sub(self.stall));
        Ok(())
    }

    fn signal(&self, signal: i32) -> Result<()> {
        // SAFETY: no memory is involved; the server is not reaped yet, so this is its number.
        match unsafe { libc::kill(self.server as i32, signal) } {
            0 => Ok(()),
            _ => Err(std::io::Error::last_os_error()).context("cannot stop or continue a server"),
        }
    }
}

impl Drop for Stalling {
    fn drop(&mut self) {
        // The server may have ended.
        _ = self.signal(libc::SIGCONT);
    }
}

fn start_proxy(program: &Path, label: &str, domain: u16, link: &str, entry: &str, folder: &Path) -> Result<Process> {
    let config = format!(
        "version: 1\nidentity: {label}.pem\nlinks: [{{to: '{link}'}}]\ngraphs: {{a: {{domain_id: {domain}}}}}\n\
         services: [{{service: {SERVICE}, card: card, {entry}}}]\n"
    );
    let (file, stats) = (folder.join(format!("{label}.yaml")), folder.join(format!("{label}.json")));
    fs::write(&file, config).with_context(|| format!("cannot write {}", file.display()))?;
    _ = fs::remove_file(&stats);
    let mut command = own(program);
    command.arg("--config").arg(&file).arg("--stats").arg(&stats);
    Process::spawn(&format!("proxy-{label}"), command, folder)
}

fn peer(label: &str, domain: u16, arguments: &[&str], folder: &Path) -> Result<Process> {
    let python = workspace::target().join("venv/bin/python");
    ensure!(python.is_file(), "{} does not exist: run `cargo xtask setup`", python.display());
    let mut command = own(python);
    command.arg(workspace::root().join("tests/peers/rclpy_calls.py")).args(arguments);
    command.env("ROS_DOMAIN_ID", domain.to_string()).env("ROS_HOME", folder).env("ROS_LOG_DIR", folder);
    Process::spawn(label, command, folder)
}

fn command(program: &Path, line: &str, folder: &Path) -> Command {
    let mut command = own(program);
    command.args(line.split_whitespace()).current_dir(folder);
    command
}

/// Runs a command to its end, and returns its output if that is JSON.
fn output(mut command: Command) -> Result<Value> {
    let output = command.output().with_context(|| format!("cannot start {:?}", command.get_program()))?;
    if !output.status.success() {
        bail!("{command:?} failed: {}", String::from_utf8_lossy(&output.stderr));
    }
    Ok(serde_json::from_slice(&output.stdout).unwrap_or_default())
}
