//! The program as a shell or systemd sees it: exit codes, what is on stdout and stderr, and that it ends when told to.
//! No switch and no root: what needs those is in the workspace's `tests`.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use gdp::cert::{AdCert, Mode, issue};
use gdp::{Identity, NameCard, SigningKey};

#[test]
fn check_reads_everything_and_says_so() {
    let files = Files::new();
    let output = files.proxy(&["--check"]);
    assert!(output.status.success(), "{output:?}");
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.contains("robot.yaml: good, 1 topics") && said.contains(&files.entity), "{said}");
}

#[test]
fn a_mistake_is_one_line_with_file_key_and_remedy() {
    let files = Files::new();
    fs::write(files.path("chatter.ad"), "no certificate").unwrap();
    let output = files.proxy(&["--check"]);
    assert_eq!((output.status.code(), &output.stdout[..]), (Some(1), &b""[..]));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("robot.yaml: topics[0].cert: ") && said.contains("chatter.ad"), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
}

#[test]
fn statistics_that_cannot_be_written_are_a_mistake_said_at_once() {
    let output = Files::new().proxy(&["--stats", "/nonexistent/stats.json"]);
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("/nonexistent/stats.json: cannot be written"), "{said}");
}

#[test]
fn wrong_usage_is_exit_code_2() {
    let output = Command::new(env!("CARGO_BIN_EXE_gdp-proxy")).arg("--confg").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn it_waits_for_a_switch_and_ends_at_sigterm() {
    let files = Files::new();
    let mut child = files.command(&["--stats", files.path("stats").to_str().unwrap()]).spawn().unwrap();
    // SIGTERM before the handler is there would kill it; that it listens shows in /proc.
    let deadline = Instant::now() + Duration::from_secs(20);
    while !catches_sigterm(child.id()) && child.try_wait().unwrap().is_none() && Instant::now() < deadline {
        std::thread::yield_now();
    }
    if catches_sigterm(child.id()) {
        assert!(Command::new("kill").arg(child.id().to_string()).status().unwrap().success());
    } else {
        child.kill().unwrap();
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
}

/// Bit 14 of the mask of caught signals.
fn catches_sigterm(pid: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 << 14 != 0)
}

/// A configuration with one topic, and all that it names; nobody listens on the link.
struct Files {
    folder: tempfile::TempDir,
    entity: String,
}

impl Files {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = |file: &str| folder.path().join(file);
        let (owner, key) = (SigningKey::generate().unwrap(), SigningKey::generate().unwrap());
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "std_msgs/msg/String", None).unwrap();
        let entity = Identity::new(key.clone(), "proxy").name();
        let (name, mode, scope, serial) = (card.name(), Mode::Unicast, vec![], 1);
        let ad = AdCert { name, entity, mode, scope, serial, not_before: 0, not_after: u64::MAX };
        let ad = issue(&owner, &ad).unwrap();
        key.save_new(&path("robot.pem")).unwrap();
        card.save_new(&path("chatter.card")).unwrap();
        fs::write(path("chatter.ad"), ad.to_pem()).unwrap();
        let config = "version: 1\nidentity: robot.pem\nlinks:\n  - to: udp://127.0.0.1:9\ntopics:\n  - {topic: /chatter, direction: out, card: \
                      chatter.card, cert: chatter.ad}\n";
        fs::write(path("robot.yaml"), config).unwrap();
        let entity = entity.to_string();
        Self { folder, entity }
    }

    fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_gdp-proxy"));
        command.arg("--config").arg(self.path("robot.yaml")).args(arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    fn proxy(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }
}
