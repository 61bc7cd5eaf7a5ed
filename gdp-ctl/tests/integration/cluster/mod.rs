//! A cluster of real etcd members on the loopback interface. Each member is a process with its data
//! in a temporary folder.

use std::net::{Ipv4Addr, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use gdp_daemon::store::Endpoint;
use gdp_tests::programs::{Executable as _, Program};
use tempfile::TempDir;

use crate::ports::free_addr;

/// Maximum time until a member answers.
const START: Duration = Duration::from_secs(60);

/// PEM files of a member's certificate and of the CA. Members with them require client
/// certificates.
pub struct Certificates {
    pub ca: PathBuf,
    pub cert: PathBuf,
    pub key: PathBuf,
}

pub struct Cluster {
    certificates: Option<Certificates>,
    members: Vec<Member>,
    folder: TempDir,
}

struct Member {
    client: u16,
    peer: u16,
    metrics: u16,
    process: Option<Child>,
}

impl Cluster {
    /// Starts `count` members, and waits until they form a cluster.
    pub fn start(count: usize) -> Self {
        Self::start_with(count, None)
    }

    /// Starts the members, with TLS if there are certificates.
    pub fn start_with(count: usize, certificates: Option<Certificates>) -> Self {
        let port = || free_addr().port();
        let member = || Member { client: port(), peer: port(), metrics: port(), process: None };
        let members = std::iter::repeat_with(member).take(count).collect();
        let mut cluster = Self { certificates, members, folder: tempfile::tempdir().unwrap() };
        (0..count).for_each(|i| cluster.spawn(i));
        cluster.await_health();
        cluster
    }

    pub fn endpoints(&self) -> Vec<Endpoint> {
        self.members.iter().map(|m| self.endpoint(m)).collect()
    }

    fn endpoint(&self, member: &Member) -> Endpoint {
        Endpoint { tls: self.certificates.is_some(), host: "127.0.0.1".into(), port: member.client }
    }

    /// Kills a member immediately, as if its machine had failed.
    pub fn kill(&mut self, index: usize) {
        if let Some(mut process) = self.members[index].process.take() {
            process.kill().unwrap();
            process.wait().unwrap();
        }
    }

    /// Restarts a killed member with its data.
    pub fn restart(&mut self, index: usize) {
        self.spawn(index);
        self.await_health();
    }

    /// Restarts all killed members.
    pub fn restart_all(&mut self) {
        let gone: Vec<usize> = (0..self.members.len()).filter(|i| self.members[*i].process.is_none()).collect();
        gone.into_iter().for_each(|i| self.restart(i));
    }

    /// Returns the index of the leader.
    pub fn leader(&self) -> usize {
        let is_leader = |i: &usize| {
            let answer = self.etcdctl(&[*i], &["endpoint", "status", "-w", "fields"]);
            let field = |name: &str| {
                let line = answer.lines().find(|line| line.starts_with(&format!("\"{name}\"")));
                line.and_then(|line| line.rsplit(' ').next()).map(str::to_owned)
            };
            field("MemberID").is_some_and(|own| field("Leader") == Some(own))
        };
        (0..self.members.len()).find(is_leader).expect("a cluster has a leader")
    }

    /// Returns the output of `etcdctl` with these arguments, run against these members.
    pub fn etcdctl(&self, members: &[usize], arguments: &[&str]) -> String {
        let urls: Vec<_> = members.iter().map(|i| self.endpoint(&self.members[*i]).to_string()).collect();
        let mut command = Program::Etcdctl.command();
        if let Some(Certificates { ca, cert, key }) = &self.certificates {
            command.arg("--cacert").arg(ca).arg("--cert").arg(cert).arg("--key").arg(key);
        }
        let output = command
            .env("ETCDCTL_API", "3")
            .arg(format!("--endpoints={}", urls.join(",")))
            .args(arguments)
            .output()
            .expect("etcdctl runs: `cargo xtask setup` installs it");
        assert!(output.status.success(), "etcdctl {arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    fn spawn(&mut self, index: usize) {
        let url = |port: u16| format!("http://127.0.0.1:{port}");
        let all = self.members.iter().enumerate().map(|(i, member)| format!("m{i}={}", url(member.peer)));
        let all = all.collect::<Vec<_>>().join(",");
        let folder = self.folder.path();
        let log =
            std::fs::File::options().create(true).append(true).open(folder.join(format!("m{index}.log"))).unwrap();
        let member = &self.members[index];
        let client = self.endpoint(member);
        let mut command = Program::Etcd.command();
        if let Some(Certificates { ca, cert, key }) = &self.certificates {
            command.arg("--client-cert-auth").arg("--trusted-ca-file").arg(ca);
            command.arg("--cert-file").arg(cert).arg("--key-file").arg(key);
        }
        let process = command
            .arg(format!("--name=m{index}"))
            .arg(format!("--data-dir={}", folder.join(format!("m{index}")).display()))
            .arg(format!("--listen-client-urls={client}"))
            .arg(format!("--advertise-client-urls={client}"))
            .arg(format!("--listen-peer-urls={}", url(member.peer)))
            .arg(format!("--initial-advertise-peer-urls={}", url(member.peer)))
            .arg(format!("--initial-cluster={all}"))
            .arg(format!("--listen-metrics-urls={}", url(member.metrics)))
            .arg("--logger=zap")
            .stdin(Stdio::null())
            .stdout(log.try_clone().unwrap())
            .stderr(log)
            .spawn()
            .expect("etcd runs: `cargo xtask setup` installs it");
        self.members[index].process = Some(process);
    }

    /// Waits until all running members answer.
    fn await_health(&self) {
        let until = Instant::now() + START;
        let running = |member: &&Member| member.process.is_some();
        for member in self.members.iter().filter(running) {
            while !is_healthy(member.metrics) {
                assert!(Instant::now() < until, "etcd does not start: see {}", self.folder.path().display());
                std::thread::sleep(Duration::from_millis(50));
            }
        }
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        (0..self.members.len()).for_each(|i| self.kill(i));
    }
}

/// Returns whether a member reports that it is healthy, which requires a leader.
fn is_healthy(port: u16) -> bool {
    use std::io::{Read, Write};
    let Ok(mut stream) = TcpStream::connect((Ipv4Addr::LOCALHOST, port)) else { return false };
    let mut answer = String::new();
    let asked = stream.write_all(b"GET /health HTTP/1.0\r\nHost: localhost\r\n\r\n");
    asked.is_ok() && stream.read_to_string(&mut answer).is_ok() && answer.contains("\"health\":\"true\"")
}
