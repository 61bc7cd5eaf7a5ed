//! `status`, `ping` and `trace` with `--switch`, from machines without a daemon, at a chain of
//! three switches: what an endpoint is shown, and what it is not.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::Output;

use gdp_core::cert::{RtCert, issue};
use gdp_core::identity::Identity;
use gdp_daemon::serve::{Running, start};
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_proto::control::{EntityRequest, Inspection, Refusal, RefusalCode, Request, Response};
use gdp_tests::programs::own;
use gdp_wire::Name;
use serde_json::Value;

use crate::switch::{Chain, config, wait};
use crate::user::expect_described;

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_and_a_laptop_ask_switches_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let site = Site::new(folder.path()).await;
    let [first, second, third] = site.chain.names[..] else { panic!("three switches") };

    let status = site.json("robot", 0, &["status"]).await.remove(0);
    assert_eq!(
        (&status["switch"], &status["data_plane"]),
        (&first.to_string().into(), &"userspace".into()),
        "{status}"
    );
    assert!(status["no_rib"].is_null() && status["release"].is_string(), "{status}");
    assert_eq!(
        (status["links"].as_array().unwrap().len(), &status["names"]),
        (1, &Value::Array(Vec::new())),
        "{status}"
    );
    let text = site.text("robot", 0, &["status"]).await;
    assert!(text.contains("RIB         reached") && text.contains("127.0.0.1:"), "{text}");
    assert!(!text.contains(&format!("{second:#}")) && !text.contains(&format!("{third:#}")), "{text}");

    let near = site.json("robot", 0, &["ping", &first.to_string()[..12], "-c", "1"]).await;
    assert!(near[0]["from"] == first.to_string() && near[0]["rtt_us"].as_u64() > Some(0), "{near:?}");

    let nobody = site.error("robot", 0, &["ping", "/chatter", "-c", "1"]).await;
    assert!(nobody.contains("nobody receives /chatter now"), "{nobody}");
    let nobody = site.error("laptop", 2, &["trace", "/chatter"]).await;
    assert!(nobody.contains("nobody publishes /chatter now"), "{nobody}");

    // Somebody reads at the third switch.
    let reading = site.spawn("reader", 2, &["topic", "echo", "/chatter", "--raw"]);
    wait("the publisher's path to its reader", async || {
        site.run("robot", 0, &["ping", "/chatter", "-c", "1"]).await.status.success()
    })
    .await;
    let far = site.json("robot", 0, &["ping", "/chatter", "-c", "2", "-i", "0.05"]).await;
    assert!(far[0]["from"] == third.to_string() && far[0]["end"]["links"] == 1, "{far:?}");
    assert_eq!((&far[2]["sent"], &far[2]["received"]), (&2.into(), &2.into()), "{far:?}");
    let trace = site.json("robot", 0, &["trace", "/chatter"]).await.remove(0);
    let hops = trace["paths"][0]["hops"].as_array().unwrap();
    let switches: Vec<_> = hops.iter().map(|hop| hop["switch"].as_str().unwrap()).collect();
    assert_eq!(switches, [first.to_string(), second.to_string(), third.to_string()], "{trace}");
    assert!(hops.iter().all(|hop| hop["rtt_us"].as_u64() > Some(0)), "{trace}");

    // A reader traces the publishers.
    let publishing =
        site.spawn("robot", 0, &["topic", "pub", "/chatter", "std_msgs/msg/String", "data: x", "-r", "10"]);
    wait("the reader's path to its publisher", async || {
        site.run("laptop", 2, &["ping", "/chatter", "-c", "1"]).await.status.success()
    })
    .await;
    let back = site.json("laptop", 2, &["trace", "/chatter"]).await.remove(0);
    assert_eq!(back["name"], site.entity("robot").to_string(), "{back}");
    assert_eq!(back["paths"][0]["egress"], first.to_string(), "{back}");
    drop((reading, publishing));

    // Without the right, the name and its prefix say nothing.
    let unknown = site.error("stranger", 0, &["ping", "/other", "-c", "1"]).await;
    assert!(unknown.contains("must be in the keyring") && unknown.contains("/other"), "{unknown}");
    let name = std::fs::read_to_string(site.folder.join("chatter.name")).unwrap();
    let refused = site.error("stranger", 0, &["trace", &name]).await;
    assert!(refused.contains("may not send to"), "{refused}");
    let refused = site.error("stranger", 0, &["trace", &site.entity("robot").to_string()]).await;
    assert!(refused.contains("may not send to"), "{refused}");
    let prefix = site.error("stranger", 0, &["trace", &third.to_string()[..8]]).await;
    assert!(prefix.contains("must be in the keyring"), "{prefix}");
}

/// An endpoint cannot make the switch work for it without bound, nor ask about other names.
#[tokio::test(flavor = "multi_thread")]
async fn an_endpoint_that_asks_too_much_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let identity = Identity::generate("proxy").unwrap();
    let port = Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::endpoint(identity)).unwrap();
    let link = port.dial(LinkAddr::udp(switch.udp_addr().unwrap()), None).await.unwrap();
    let name = Name::from_bytes([7; 32]);
    let probe = Request::Inspect(Inspection::Probe { name, egress: switch.name(), hops: 64 });
    let response = link.request(&probe).await.unwrap();
    let refused =
        |response: &Response, code| matches!(response, Response::Refused(Refusal { code: got, .. }) if *got == code);
    assert!(refused(&response, RefusalCode::NotFound), "{response:?}");
    let (mut answered, mut limited) = (0, 0);
    for _ in 0..200 {
        match link.request(&Request::Inspect(Inspection::Status)).await.unwrap() {
            // Only an attached endpoint learns anything.
            response if refused(&response, RefusalCode::NotEntitled) => answered += 1,
            response => {
                assert!(refused(&response, RefusalCode::Limit), "{response:?}");
                limited += 1;
            }
        }
    }
    assert!(answered >= 60 && limited > 0, "{answered} answered, {limited} refused");
    switch.stop().await;
}

/// Who is refused leaves a counter and an event, and the reason in the status.
#[tokio::test(flavor = "multi_thread")]
async fn a_refused_registration_is_counted_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), "s1");
    let socket = config.socket.clone();
    let switch = start(config).await.unwrap();
    let events = tokio::task::spawn_blocking(move || {
        let mut stream = std::os::unix::net::UnixStream::connect(socket).unwrap();
        stream.write_all(b"{\"v\":2,\"op\":\"monitor\"}\n").unwrap();
        let mut lines = BufReader::new(stream).lines();
        assert!(lines.next().unwrap().unwrap().contains("monitoring"));
        lines
    });
    let lines = events.await.unwrap();
    let identity = Identity::generate("proxy").unwrap();
    let (entity, elsewhere) = (identity.name(), Name::from_bytes([7; 32]));
    let rt_cert = issue(identity.key(), &RtCert { entity, switch: elsewhere, not_after: u64::MAX }).unwrap();
    let port = Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::endpoint(identity)).unwrap();
    let link = port.dial(LinkAddr::udp(switch.udp_addr().unwrap()), None).await.unwrap();
    let attach = Request::Entity(EntityRequest::Attach { rt_cert, resumes: false, lane: 0 });
    let response = link.request(&attach).await.unwrap();
    assert!(
        matches!(&response, Response::Refused(refusal) if refusal.code == RefusalCode::WrongSwitch),
        "{response:?}"
    );

    let status = switch.status().await;
    assert_eq!(status["refused_total"]["registration"]["WrongSwitch"], 1, "{status}");
    assert_eq!(status["refused"][0]["peer"], entity.to_string(), "{status}");
    let event = tokio::task::spawn_blocking(move || {
        lines.map(|line| line.unwrap()).find(|line| line.contains("registration_refused")).unwrap()
    });
    let line: Value = serde_json::from_str(&event.await.unwrap()).unwrap();
    let event = &line["event"];
    assert_eq!((&event["entity"], &event["code"]), (&entity.to_string().into(), &"WrongSwitch".into()), "{event}");
    assert!(event["reason"].as_str().unwrap().contains("wrong switch"), "{event}");
    switch.stop().await;
}

/// Three switches, and a folder for each user's key.
struct Site<'a> {
    folder: &'a Path,
    chain: Chain<'a>,
    _running: Vec<Running>,
}

impl<'a> Site<'a> {
    async fn new(folder: &'a Path) -> Self {
        let chain = Chain::new(folder);
        let mut running = Vec::new();
        for i in 0..3 {
            running.push(start(chain.config(i)).await.unwrap());
        }
        let site = Self { folder, chain, _running: running };
        for user in ["owner", "robot", "laptop", "reader", "stranger"] {
            std::fs::create_dir(folder.join(user)).unwrap();
            let kind = if user == "owner" { "owner" } else { "proxy" };
            site.tool(&["key", "generate", &format!("{user}/id.pem"), "--kind", kind]).await;
        }
        let create = ["name", "create", "--owner", "owner/id.pem", "--topic", "/chatter", "-o", "chatter.card"];
        let card = site.tool(&[&create[..], &["--type", "std_msgs/msg/String"]].concat()).await;
        std::fs::write(folder.join("chatter.name"), card["name"].as_str().unwrap()).unwrap();
        for (user, right, ending) in
            [("robot", "--publish", "ad"), ("laptop", "--read", "grant"), ("reader", "--read", "grant")]
        {
            let (entity, file) = (format!("{user}/id.pem"), format!("{user}/chatter.{ending}"));
            let add =
                ["grant", "add", "chatter.card", "--key", "owner/id.pem", right, "--entity", &entity, "-o", &file];
            site.tool(&add).await;
            std::fs::copy(folder.join("chatter.card"), folder.join(user).join("chatter.card")).unwrap();
        }
        wait("the switches to reach the RIB", async || {
            let status = site.run("robot", 0, &["status"]).await;
            String::from_utf8_lossy(&status.stdout).contains("RIB         reached")
        })
        .await;
        site
    }

    fn entity(&self, user: &str) -> Name {
        Identity::load_or_generate(&self.folder.join(user).join("id.pem"), "proxy").unwrap().name()
    }

    fn command(&self, user: &str, switch: usize, arguments: &[&str]) -> tokio::process::Command {
        let mut command = own(env!("CARGO_BIN_EXE_gdp-ctl"));
        command.args(arguments).current_dir(self.folder).env_remove("RUST_LOG");
        command.arg("--keyring").arg(PathBuf::from(user));
        command.arg("--switch").arg(format!("udp://{}", self.chain.addrs[switch])).arg("--socket").arg("nowhere.sock");
        let mut command = tokio::process::Command::from(command);
        command.kill_on_drop(true);
        command
    }

    async fn run(&self, user: &str, switch: usize, arguments: &[&str]) -> Output {
        self.command(user, switch, arguments).output().await.unwrap()
    }

    fn spawn(&self, user: &str, switch: usize, arguments: &[&str]) -> tokio::process::Child {
        let mut command = self.command(user, switch, arguments);
        command.stdout(std::process::Stdio::null()).spawn().unwrap()
    }

    async fn text(&self, user: &str, switch: usize, arguments: &[&str]) -> String {
        let output = self.run(user, switch, arguments).await;
        assert!(output.status.success(), "{arguments:?}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    async fn json(&self, user: &str, switch: usize, arguments: &[&str]) -> Vec<Value> {
        let text = self.text(user, switch, &[&["-j"], arguments].concat()).await;
        let values: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        values.iter().for_each(|value| expect_described(arguments, value));
        values
    }

    async fn error(&self, user: &str, switch: usize, arguments: &[&str]) -> String {
        let output = self.run(user, switch, arguments).await;
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {output:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    }

    /// Runs a command that needs no switch.
    async fn tool(&self, arguments: &[&str]) -> Value {
        let mut command = own(env!("CARGO_BIN_EXE_gdp-ctl"));
        command.args(["-j"]).args(arguments).current_dir(self.folder);
        let output = tokio::process::Command::from(command).output().await.unwrap();
        assert!(output.status.success(), "{arguments:?}: {output:?}");
        serde_json::from_slice(&output.stdout).unwrap()
    }
}
