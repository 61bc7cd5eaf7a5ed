//! The logs of daemon and proxy: behaviour when logs cannot be written, the report of a panic, and
//! a normal run without lines from foreign crates.
//!
//! ```text
//!  topic pub ─┐
//!  proxy ─────┴─ lo ── daemon
//! ```

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::fabric::{Authority, Mounted, TOPIC, TYPE};
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program, own};
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};

/// Exit status of a program that ends because of a panic.
const PANICKED: i32 = 101;

#[test]
fn a_log_disk_that_is_full_costs_nothing_but_lines_of_the_log() -> Result<()> {
    let site = Site::build()?;
    let disk = Mounted(site.file("disk"));
    fs::create_dir(&disk.0)?;
    execute(Program::Mount.command().args(["-t", "tmpfs", "-o", "size=64k", "tmpfs"]).arg(&disk.0))?;
    let logs = ["daemon", "again", "proxy"].map(|label| disk.0.join(label));
    let log = |i: usize| OpenOptions::new().append(true).create(true).open(&logs[i]).context("a log on the disk");
    let mut daemon = site.daemon("daemon", log(0)?.into())?;
    site.publish()?;
    let mut proxy = site.proxy("proxy", log(2)?.into())?;
    site.wait_for_link()?;

    let filler = disk.0.join("filler");
    // The copy ends with an error when the file system is full.
    let _ = std::io::copy(&mut std::io::repeat(b'x'), &mut File::create(&filler)?);
    site.publish()?;
    daemon.kill()?;
    daemon = site.daemon("again", log(1)?.into())?;
    site.wait_for_link()?;
    site.publish()?;

    fs::remove_file(&filler)?;
    site.publish()?;
    site.wait_for_link()?;
    ensure!(daemon.stop(TIMEOUT)?.success(), "{}", daemon.report());
    ensure!(proxy.stop(TIMEOUT)?.success(), "{}", proxy.report());
    let text = fs::read_to_string(&logs[1])?;
    ensure!(text.contains("lines of the log were dropped"), "{text}");
    Ok(())
}

#[test]
fn a_log_that_nobody_takes_costs_nothing_else() -> Result<()> {
    type Sink<'a> = Box<dyn Fn() -> Result<Stdio> + 'a>;
    let (_full, full) = full_pipe()?;
    let sinks: [(&str, Sink<'_>); 3] = [
        ("/dev/full", Box::new(|| Ok(OpenOptions::new().write(true).open("/dev/full")?.into()))),
        ("a pipe whose reader has ended", Box::new(|| Ok(std::io::pipe()?.1.into()))),
        ("a pipe whose reader stands still", Box::new(|| Ok(full.try_clone()?.into()))),
    ];
    for (what, sink) in sinks {
        let site = Site::build()?;
        let run = || -> Result<()> {
            let mut daemon = site.daemon("daemon", sink()?)?;
            site.publish()?;
            let mut proxy = site.proxy("proxy", sink()?)?;
            site.wait_for_link()?;
            daemon.kill()?;
            let mut daemon = site.daemon("again", sink()?)?;
            site.wait_for_link()?;
            site.publish()?;
            ensure!(daemon.stop(TIMEOUT)?.success(), "the daemon's status");
            ensure!(proxy.stop(TIMEOUT)?.success(), "the proxy's status");
            Ok(())
        };
        run().context(what)?;
    }
    Ok(())
}

#[test]
fn a_task_that_panics_ends_the_daemon_or_the_proxy() -> Result<()> {
    let site = Site::build()?;
    let stderr = |label: &str| File::create(site.file(&format!("{label}.err")));
    let mut daemon = site.daemon("daemon", stderr("daemon")?.into())?;
    let mut proxy = site.proxy("proxy", stderr("proxy")?.into())?;
    site.wait_for_link()?;
    for (label, process) in [("proxy", &mut proxy), ("daemon", &mut daemon)] {
        fs::write(site.trigger(label), "")?;
        let status = wait_for("its end", TIMEOUT, || process.status())?;
        ensure!(status.code() == Some(PANICKED), "{status}: {}", process.report());
        let log = process.stderr();
        let line = log.lines().find(|line| line.contains("panicked")).with_context(|| log.clone())?;
        ensure!(line.contains("ERROR gdp_util::panics: ") && line.contains("injected"), "{line}");
    }

    let (_full, full) = full_pipe()?;
    let mut daemon = site.daemon("unheard", full.into())?;
    fs::write(site.trigger("unheard"), "")?;
    let status = wait_for("its end with a log that stands still", TIMEOUT, || daemon.status())?;
    ensure!(status.code() == Some(PANICKED), "{status}");
    Ok(())
}

#[test]
fn a_normal_start_and_stop_logs_nothing_of_other_crates() -> Result<()> {
    let site = Site::build()?;
    for _ in 0..5 {
        let stderr = |label: &str| File::create(site.file(&format!("{label}.err")));
        let mut daemon = site.daemon("daemon", stderr("daemon")?.into())?;
        let mut proxy = site.proxy("proxy", stderr("proxy")?.into())?;
        site.wait_for_link()?;
        site.publish()?;
        ensure!(proxy.stop(TIMEOUT)?.success(), "{}", proxy.report());
        ensure!(daemon.stop(TIMEOUT)?.success(), "{}", daemon.report());
        for process in [&daemon, &proxy] {
            let log = process.stderr();
            ensure!(!log.is_empty(), "it logs nothing at all");
            let foreign = foreign_lines(&log);
            ensure!(foreign.is_empty(), "{foreign:#?}");
        }
    }
    Ok(())
}

/// Returns the log lines of other crates than this project's.
pub fn foreign_lines(log: &str) -> Vec<&str> {
    let is_ours = |line: &&str| line.split_whitespace().nth(2).is_some_and(|target| target.starts_with("gdp"));
    log.lines().filter(|line| !is_ours(line)).collect()
}

/// Returns a pipe that accepts no more data until its first end is dropped.
fn full_pipe() -> Result<(std::io::PipeReader, std::io::PipeWriter)> {
    let (reader, mut writer) = std::io::pipe()?;
    // The default capacity of a pipe (pipe(7)).
    writer.write_all(&[b'\n'; 1 << 16])?;
    Ok((reader, writer))
}

/// A host with all files that a daemon, a proxy and `topic pub` need.
struct Site {
    host: Namespace,
    tools: Tools,
    folder: tempfile::TempDir,
}

impl Site {
    fn build() -> Result<Self> {
        let (host, tools) = (Namespace::create("host")?, Tools::beside_this_test()?);
        host.enable_loopback_multicast()?;
        let folder = tempfile::Builder::new().prefix("gdp-logs-").tempdir()?;
        let authority = Authority { tools: &tools, folder: folder.path() };
        authority.topic()?;
        authority.admit("robot", "--publish")?;
        authority.admit("publisher", "--publish")?;
        let keyring = folder.path().join("publisher");
        fs::rename(keyring.join("chatter.cert"), keyring.join("chatter.ad"))?;
        let site = Self { host, tools, folder };
        let config = json!({
            "identity": site.file("switch.pem"), "socket": site.file("switch.sock"), "interfaces": [],
            "udp": "0.0.0.0:31415", "data_plane": "userspace", "rib": true,
        });
        fs::write(site.file("switch.yaml"), config.to_string())?;
        let config = json!({
            "version": 1, "identity": "key.pem", "links": [{"to": "udp://127.0.0.1"}],
            "topics": [{"topic": TOPIC, "direction": "out", "card": "chatter.card", "cert": "chatter.cert"}],
        });
        fs::write(site.file("robot/proxy.yaml"), config.to_string())?;
        Ok(site)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Returns a file whose appearance makes a task of a program panic.
    fn trigger(&self, label: &str) -> PathBuf {
        self.file(&format!("{label}.panic"))
    }

    /// Starts a daemon and waits until it answers.
    fn daemon(&self, label: &str, stderr: Stdio) -> Result<Process> {
        let mut command = self.host.command(self.tools.gdp_ctl()?)?;
        command.args(["serve", "--config"]).arg(self.file("switch.yaml"));
        let mut daemon = self.spawn(label, command, stderr)?;
        wait_for("the daemon to answer", TIMEOUT, || {
            daemon.check_alive()?;
            Ok(self.status().ok().map(drop))
        })?;
        Ok(daemon)
    }

    fn proxy(&self, label: &str, stderr: Stdio) -> Result<Process> {
        let mut command = self.host.command(self.tools.gdp_proxy()?)?;
        command.arg("--config").arg(self.file("robot/proxy.yaml"));
        self.spawn(label, command, stderr)
    }

    fn spawn(&self, label: &str, mut command: Command, stderr: Stdio) -> Result<Process> {
        command.env("GDP_TEST_PANIC", self.trigger(label)).env_remove("RUST_LOG").env_remove("RUST_BACKTRACE");
        Process::spawn_with_stderr(label, command, self.folder.path(), stderr)
    }

    fn status(&self) -> Result<Value> {
        let mut command = own(self.tools.gdp_ctl()?);
        Ok(serde_json::from_str(&execute(command.args(["status", "-j", "--socket"]).arg(self.file("switch.sock")))?)?)
    }

    /// Waits until the proxy has a link to the daemon.
    fn wait_for_link(&self) -> Result<()> {
        wait_for("the proxy's link", TIMEOUT, || {
            let links = self.status()?["links"].as_array().map_or(0, Vec::len);
            Ok((links > 0).then_some(()))
        })
    }

    /// Attaches, publishes a message, and detaches.
    fn publish(&self) -> Result<()> {
        let mut command = self.host.command(self.tools.gdp_ctl()?)?;
        command.args(["topic", "pub", "-t", "1", "-w", "0", TOPIC, TYPE, "{data: x}", "--switch", "udp://127.0.0.1"]);
        command.arg("--keyring").arg(self.file("publisher")).arg("--key").arg(self.file("publisher/key.pem"));
        let mut publisher = Process::spawn("publisher", command, self.folder.path())?;
        let status = wait_for("`topic pub` to end", TIMEOUT, || publisher.status())?;
        ensure!(status.success(), "{status}: {}", publisher.report());
        Ok(())
    }
}
