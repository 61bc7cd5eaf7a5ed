//! The admin socket of a proxy, over a real socket.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;

use gdp::unstable::NodeCounters;
use gdp_wire::Name;

use super::*;
use crate::stats::VERSION;

fn config(folder: &std::path::Path, more: &str) -> Config {
    let text =
        format!("version: 1\nidentity: key.pem\nlinks: [{{to: 'udp://127.0.0.1:9'}}]\nsocket: proxy.sock\n{more}");
    Config::parse(&text, &folder.join("proxy.yaml")).unwrap()
}

fn stats() -> Stats {
    Stats {
        version: VERSION,
        entity: Name::from_bytes([7; 32]),
        switch: None,
        member_until: Some(5),
        member_error: None,
        topics: vec![],
        catalogs: vec![],
        directory: None,
        calls: vec![],
        links: vec![],
        clocks: vec![],
        node: NodeCounters::default(),
    }
}

fn ask(path: PathBuf, line: &'static str) -> tokio::task::JoinHandle<String> {
    tokio::task::spawn_blocking(move || {
        let mut stream = UnixStream::connect(path).unwrap();
        stream.write_all(line.as_bytes()).unwrap();
        let mut answer = String::new();
        BufReader::new(stream).read_line(&mut answer).unwrap();
        answer
    })
}

#[tokio::test]
async fn it_answers_status_with_the_statistics_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let (_serving, mut requests) = serve(&config(folder.path(), "")).unwrap();
    let asked = ask(folder.path().join("proxy.sock"), "{\"v\":2,\"op\":\"status\"}\n");
    assert!(requests.next().await.send(stats()).is_ok());
    let answer: serde_json::Value = serde_json::from_str(&asked.await.unwrap()).unwrap();
    assert_eq!(answer["proxy"], serde_json::to_value(stats()).unwrap());
    for (line, says) in [("{\"v\":2,\"op\":\"monitor\"}\n", "socket of a proxy"), ("{}\n", "no protocol version")] {
        let answer = ask(folder.path().join("proxy.sock"), line).await.unwrap();
        assert!(answer.contains("\"error\"") && answer.contains(says), "{answer}");
    }
    // A second proxy with the same file does not take it away.
    let second = serve(&config(folder.path(), "")).map(drop).unwrap_err().to_string();
    assert!(second.contains("already answers"), "{second}");
}

#[tokio::test]
async fn metrics_of_other_machines_need_a_token() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |more: &str| {
        let error = serve(&config(folder.path(), more)).map(drop).unwrap_err();
        format!("{error:#}")
    };
    assert!(refused("metrics: 0.0.0.0:0\n").contains("name a token file"));
    assert!(refused("metrics: 127.0.0.1:0\nmetrics_token: none\n").contains("cannot read the token file"));
    std::fs::write(folder.path().join("token"), "0123456789abcdef0123456789abcdef\n").unwrap();
    assert!(refused("metrics: 0.0.0.0:0\nmetrics_token: token\n").contains("chmod o="));
    use std::os::unix::fs::PermissionsExt as _;
    std::fs::set_permissions(folder.path().join("token"), std::fs::Permissions::from_mode(0o600)).unwrap();
    assert!(serve(&config(folder.path(), "metrics: 0.0.0.0:0\nmetrics_token: token\n")).is_ok());
    assert_eq!(config(folder.path(), "metrics: 9405\n").metrics.unwrap().to_string(), "127.0.0.1:9405");
}
