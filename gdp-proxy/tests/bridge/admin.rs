//! The admin socket and the metrics of a proxy that carries messages.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::process::Stdio;

use gdp_proxy::ros2::Domain;
use gdp_tests::dds_domain::lease;
use gdp_tests::programs::{Executable as _, Program};
use serde_json::Value;

use crate::lives::{domain, string, topic};
use crate::site::Site;
use crate::{RELIABLE, until};

/// The status and the metrics say the same, and promtool takes the metrics.
#[tokio::test(flavor = "multi_thread")]
async fn status_and_metrics_of_a_proxy_agree() {
    let site = Site::start().await;
    let id = lease();
    let node = Domain::join(id, "talker").unwrap();
    let _talker = node.writer(&topic("/chatter"), &string(), &RELIABLE).unwrap();
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let more = "socket: proxy.sock\nmetrics: 127.0.0.1:0";
    let proxy = site.proxy_of("a", &domain(id), &topics, "direction: out", more);
    let _reader = site.subscribe(&topics[0]).await;
    until("the topic", || proxy.topics().first().is_some_and(|topic| topic["fabric"]["readers"] == 1)).await;
    let log = site.log("a");
    let address = log.split_once("metrics on http://").unwrap().1.split_once('/').unwrap().0.to_owned();
    let mut stream = TcpStream::connect(&address).unwrap();
    write!(stream, "GET /metrics HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n").unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    let body = response.split_once("\r\n\r\n").unwrap().1;

    let mut socket = UnixStream::connect(site.folder("a").join("proxy.sock")).unwrap();
    socket.write_all(b"{\"v\":2,\"op\":\"status\"}\n").unwrap();
    let mut line = String::new();
    BufReader::new(socket).read_line(&mut line).unwrap();
    let status: Value = serde_json::from_str(&line).unwrap();
    let shown = &status["proxy"]["topics"][0];
    assert_eq!((&shown["topic"], &shown["direction"]), (&"/chatter".into(), &"out".into()), "{status}");
    let labels = "graph=\"a\",topic=\"/chatter\",direction=\"out\"";
    for line in [
        "gdp_proxy_attached 1".to_owned(),
        format!("gdp_topic_messages_total{{{labels}}} {}", shown["messages"]),
        format!("gdp_topic_readers{{{labels}}} {}", shown["fabric"]["readers"]),
        format!("gdp_certificate_expiry_timestamp_seconds{{{labels}}} {}", shown["certificate_until"]),
    ] {
        assert!(body.lines().any(|found| found == line), "{line}: {body}");
    }

    let mut promtool = Program::Promtool.command();
    promtool.args(["check", "metrics"]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut promtool = promtool.spawn().expect("promtool; `cargo xtask setup` installs it");
    promtool.stdin.take().unwrap().write_all(body.as_bytes()).unwrap();
    let output = promtool.wait_with_output().unwrap();
    assert!(output.status.success(), "{output:?}");
    node.leave().await;
}
