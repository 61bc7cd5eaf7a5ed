//! Metrics of a real daemon, and its admin socket with many monitors.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use gdp_tests::programs::{Executable as _, Program};

use crate::user::User;

const SECRET: &str = "0123456789abcdef0123456789abcdef";

/// A daemon with metrics, which ends with the test.
struct Daemon {
    child: Child,
    metrics: String,
}

impl Drop for Daemon {
    fn drop(&mut self) {
        _ = self.child.kill();
        _ = self.child.wait();
    }
}

impl Daemon {
    fn start(user: &User, more: &str) -> Self {
        let config = format!(
            "identity: switch.pem\nsocket: ctl.sock\ninterfaces: []\nudp: 127.0.0.1:0\ndata_plane: userspace\n\
             metrics: 127.0.0.1:0\n{more}"
        );
        std::fs::write(user.file("daemon.yaml"), config).unwrap();
        let mut command = user.command(&["serve", "--config", "daemon.yaml"]);
        let mut child = command.env_remove("GDP_SOCKET").stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let ready = lines.find(|line| line.contains("metrics: on http://")).expect("the daemon does not get ready");
        let metrics = ready.split_once("metrics: on http://").unwrap().1.split_once('/').unwrap().0.to_owned();
        // The daemon may log more than a pipe holds.
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, metrics }
    }

    fn scrape(&self, headers: &str) -> String {
        let mut stream = TcpStream::connect(&self.metrics).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let request = format!("GET /metrics HTTP/1.1\r\nhost: {}\r\nconnection: close\r\n{headers}\r\n", self.metrics);
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }
}

/// Returns the body of a response with status 200.
fn body(response: &str) -> &str {
    assert!(response.starts_with("HTTP/1.1 200 "), "{response}");
    response.split_once("\r\n\r\n").unwrap().1
}

#[test]
fn the_metrics_are_the_figures_of_status_and_promtool_takes_them() {
    let user = User::new();
    let daemon = Daemon::start(&user, "");
    let response = daemon.scrape("");
    let samples: HashMap<&str, f64> = body(&response)
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| line.rsplit_once(' ').unwrap())
        .map(|(series, value)| (series, value.parse().unwrap()))
        .collect();
    let status = user.json(&["status"]);
    for (counter, planes) in status["counters_by_plane"].as_object().unwrap() {
        for (plane, frames) in planes.as_object().unwrap() {
            let series = match counter.strip_prefix("drop_") {
                Some(reason) => format!("gdp_frames_dropped_total{{reason=\"{reason}\",plane=\"{plane}\"}}"),
                None => format!("gdp_frames_total{{counter=\"{counter}\",plane=\"{plane}\"}}"),
            };
            assert_eq!(samples.get(&*series).copied(), frames.as_f64(), "{series}");
        }
    }
    let same = [
        ("gdp_fib_names", &status["fib"]["names"]),
        ("gdp_rib_names", &status["rib"]["names"]),
        ("gdp_rib_switches", &status["rib"]["switches"]),
        ("gdp_topology_switches{state=\"reached\"}", &status["topology"]["reached"]),
        ("gdp_handshakes_total{outcome=\"failed\"}", &status["handshakes"]["failed"]),
    ];
    for (series, value) in same {
        assert_eq!(samples.get(series).copied(), value.as_f64(), "{series}");
    }
    check(body(&response));
    let open = daemon.scrape("accept: application/openmetrics-text\r\n");
    assert!(open.contains("application/openmetrics-text") && open.ends_with("# EOF\n"), "{open}");
}

/// Lets promtool look for mistakes.
fn check(metrics: &str) {
    let mut command = Program::Promtool.command();
    command.args(["check", "metrics"]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("promtool; `cargo xtask setup` installs it");
    child.stdin.take().unwrap().write_all(metrics.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}: {metrics}");
}

#[test]
fn metrics_with_a_token_need_it_and_other_machines_need_a_token() {
    let user = User::new();
    std::fs::write(user.file("token"), SECRET).unwrap();
    std::fs::set_permissions(user.file("token"), std::fs::Permissions::from_mode(0o600)).unwrap();
    let daemon = Daemon::start(&user, "metrics_token: token\n");
    assert!(daemon.scrape("").starts_with("HTTP/1.1 401 "));
    assert!(daemon.scrape("authorization: Bearer 0123456789abcdef\r\n").starts_with("HTTP/1.1 401 "));
    body(&daemon.scrape(&format!("authorization: Bearer {SECRET}\r\n")));
    let user = User::new();
    let config = "identity: switch.pem\nsocket: ctl.sock\nudp: 127.0.0.1:0\ndata_plane: userspace\n";
    std::fs::write(user.file("daemon.yaml"), config).unwrap();
    let refused = user.run(&["serve", "--config", "daemon.yaml", "--metrics", "0.0.0.0:0"]);
    let stderr = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && stderr.contains("name a token file"), "{stderr}");
}

#[test]
fn monitors_leave_room_for_status() {
    let user = User::new();
    let _daemon = Daemon::start(&user, "");
    let monitor = || {
        let mut stream = UnixStream::connect(user.file("ctl.sock")).unwrap();
        stream.write_all(b"{\"v\":2,\"op\":\"monitor\"}\n").unwrap();
        let mut answer = String::new();
        BufReader::new(&stream).read_line(&mut answer).unwrap();
        (stream, answer)
    };
    let monitors: Vec<_> = (0..64).map(|_| monitor()).collect();
    assert!(monitors.iter().all(|(_, answer)| answer.contains("monitoring")));
    let asked = Instant::now();
    user.json(&["status"]);
    // Generous, because the machine may be busy; a second is what a user waits.
    assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
    let refused = user.failure(1, &["monitor"]);
    assert_eq!(refused["code"], "Limit", "{refused}");
    assert!(refused["reason"].as_str().unwrap().contains("64 clients watch"), "{refused}");
    // Commands that never end are refused too, instead of kept waiting.
    let idle: Vec<_> = (0..40).map(|_| UnixStream::connect(user.file("ctl.sock")).unwrap()).collect();
    let asked = Instant::now();
    let refused = user.failure(1, &["status"]);
    assert!(refused["reason"].as_str().unwrap().contains("32 commands are connected"), "{refused}");
    assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
    drop((monitors, idle));
}
