//! Path probing and its answers: `ping`, `trace`, `peer list`, `monitor` and `topology` at three
//! daemons on loopback UDP.

use std::net::UdpSocket;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use crate::switch::{Chain, config, wait};
use crate::user::expect_described;
use gdp_core::identity::Identity;
use gdp_daemon::serve::{Running, start};
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_proto::admin::VERSION;
use gdp_proto::control::{Refusal, RefusalCode, Request, Response, Traced};
use gdp_tests::programs::own;
use gdp_wire::Name;
use serde_json::Value;
use tokio::io::{AsyncBufReadExt, BufReader};

#[tokio::test(flavor = "multi_thread")]
async fn switches_answer_near_and_far() {
    let folder = tempfile::tempdir().unwrap();
    let chain = Chain::new(folder.path());
    let mut running = chain.start().await;
    let [_, second, third] = chain.names[..] else { panic!("three switches") };

    let near = chain.lines(0, &["ping", &second.to_string(), "-c", "2", "-i", "0.05"]).await;
    assert_eq!(near.len(), 3, "{near:?}");
    assert!(near[..2].iter().all(|line| line["rtt_us"].is_u64() && line["v"] == VERSION), "{near:?}");
    assert_eq!((&near[2]["sent"], &near[2]["received"], &near[2]["loss_percent"]), (&2.into(), &2.into(), &0.0.into()));
    let far = chain.lines(0, &["ping", &third.to_string()[..12], "-c", "1"]).await;
    assert_eq!(far[0]["from"], third.to_string(), "a prefix is enough: {far:?}");
    assert!(far[0]["rtt_us"].is_u64() && far[0]["end"]["links"] == 0, "{far:?}");

    let trace = chain.lines(0, &["trace", &third.to_string()]).await.remove(0);
    let hops = trace["paths"][0]["hops"].as_array().unwrap();
    let switches: Vec<_> = hops.iter().map(|hop| hop["switch"].as_str().unwrap().to_owned()).collect();
    assert_eq!(switches, chain.names.iter().map(Name::to_string).collect::<Vec<_>>(), "{trace}");
    let short = chain.run(0, &["trace", &third.to_string(), "--max-hops", "1"]).await;
    assert_eq!(short.status.code(), Some(1), "{short:?}");
    assert!(String::from_utf8_lossy(&short.stderr).contains("did not get to every switch"), "{short:?}");
    let text = chain.run(0, &["trace", &third.to_string()]).await;
    assert!(String::from_utf8_lossy(&text.stdout).contains(&format!(" 2  {third:#}")), "{text:?}");

    for (what, status, needle) in [
        (Name::from_bytes([9; 32]).to_string(), 1, "knows no way to"),
        ("0123456789abcdef0".into(), 1, "knows no name that begins with"),
        ("topic".into(), 1, "neither a file nor the beginning of a name"),
    ] {
        for verb in ["ping", "trace"] {
            let output = chain.run(0, &[verb, &what]).await;
            let error = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(output.status.code() == Some(status) && error.contains(needle), "{verb} {what}: {error}");
        }
    }

    running.remove(2).stop().await;
    wait("the last switch to be off the map", async || {
        chain.run(0, &["ping", &third.to_string(), "-c", "1"]).await.status.code() == Some(1)
    })
    .await;
}

/// Any attached endpoint can send unsolicited or forged probe answers. Switches must ignore them.
#[tokio::test(flavor = "multi_thread")]
async fn an_endpoint_answers_no_probes() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let identity = Identity::generate("proxy").unwrap();
    let port = Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::endpoint(identity)).unwrap();
    let link = port.dial(LinkAddr::udp(switch.udp_addr().unwrap()), None).await.unwrap();
    let answer = Traced { cookie: 1, switch: switch.name(), end: None };
    let response = link.request(&Request::Traced(answer)).await.unwrap();
    let refused = matches!(&response, Response::Refused(Refusal { code: RefusalCode::Malformed, .. }));
    assert!(refused, "{response:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_happens_is_told_and_peers_say_why_there_is_no_link() {
    let folder = tempfile::tempdir().unwrap();
    let chain = Chain::new(folder.path());
    let mut running = chain.start().await;
    let second = chain.names[1].to_string();

    let mut monitor = tokio::process::Command::from(chain.command(0, &["monitor", "-j"]));
    let mut monitor = monitor.stdout(Stdio::piped()).kill_on_drop(true).spawn().unwrap();
    let mut events = BufReader::new(monitor.stdout.take().unwrap()).lines();
    let listed = chain.lines(0, &["peer", "list"]).await.remove(0);
    let peer = &listed["peers"][0];
    assert_eq!(
        (&peer["peer"], &peer["link"], &peer["relationship"]),
        (&second.clone().into(), &"up".into(), &"stranger".into())
    );

    // Events before the command listens are lost, so cause events repeatedly.
    let mut seen = Vec::new();
    while !seen.contains(&"link_down".to_owned()) || !seen.contains(&"topology".to_owned()) {
        running.remove(1).stop().await;
        wait("the address to be free", async || UdpSocket::bind(chain.addrs[1]).is_ok()).await;
        wait("the peer to be down", async || chain.lines(0, &["peer", "list"]).await[0]["peers"][0]["link"] != "up")
            .await;
        running.insert(1, start(chain.config(1)).await.unwrap());
        chain.all_see_each_other().await;
        while let Ok(Ok(Some(line))) = tokio::time::timeout(Duration::from_millis(300), events.next_line()).await {
            let event: Value = serde_json::from_str(&line).unwrap();
            assert!(event["v"] == VERSION && event["at"].is_u64(), "{event}");
            expect_described(&["monitor"], &event);
            if event["event"] == "link_down" || event["event"] == "link_up" {
                assert_eq!(event["peer"], second, "{event}");
            }
            seen.push(event["event"].as_str().unwrap().to_owned());
        }
    }
    assert!(seen.contains(&"link_up".to_owned()), "{seen:?}");

    running.remove(1).stop().await;
    wait("a reason", async || {
        let listed = chain.lines(0, &["peer", "list"]).await.remove(0);
        let peer = &listed["peers"][0];
        peer["link"] == "down" && peer["reason"].as_str().is_some_and(|reason| !reason.is_empty())
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_topology_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let chain = Chain::new(folder.path());
    let _running = chain.start().await;
    let output = chain.run(2, &["topology", "--dot", "--names"]).await;
    let graph = String::from_utf8(output.stdout).unwrap();
    assert!(graph.starts_with("graph {") && graph.trim_end().ends_with('}'), "{graph}");
    for name in &chain.names {
        assert!(graph.contains(&format!("{name:#}")), "{graph}");
    }
    assert_eq!((graph.matches(" -- ").count(), graph.matches("(RIB)").count()), (2, 1), "{graph}");
    let elsewhere = chain.run(0, &["topology", "--dot", "--names"]).await;
    assert!(String::from_utf8_lossy(&elsewhere.stderr).contains("not the RIB"), "{elsewhere:?}");
    assert_eq!(chain.run(0, &["topology", "--dot", "--json"]).await.status.code(), Some(2));
}

impl Chain<'_> {
    async fn start(&self) -> Vec<Running> {
        let mut running = Vec::new();
        for i in 0..3 {
            running.push(start(self.config(i)).await.unwrap());
        }
        self.all_see_each_other().await;
        running
    }

    async fn all_see_each_other(&self) {
        for i in 0..3 {
            wait("paths to all switches", async || {
                let topology = self.lines(i, &["topology"]).await.remove(0);
                let switches = topology["switches"].as_array().unwrap();
                switches.iter().filter(|switch| switch["bit"].is_u64() && switch["cost"].is_u64()).count() == 3
            })
            .await;
        }
    }

    fn command(&self, i: usize, arguments: &[&str]) -> Command {
        let mut command = own(env!("CARGO_BIN_EXE_gdp-ctl"));
        command.arg("--socket").arg(self.folder.join(format!("s{}.sock", i + 1))).args(arguments);
        command.env_remove("RUST_LOG").env_remove("RUST_BACKTRACE");
        command
    }

    async fn run(&self, i: usize, arguments: &[&str]) -> Output {
        let mut command = self.command(i, arguments);
        tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap()
    }

    /// Returns the output lines of a successful command with `-j`.
    async fn lines(&self, i: usize, arguments: &[&str]) -> Vec<Value> {
        let output = self.run(i, &[&["-j"], arguments].concat()).await;
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8(output.stdout).unwrap();
        let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        lines.iter().for_each(|line| expect_described(arguments, line));
        lines
    }
}
