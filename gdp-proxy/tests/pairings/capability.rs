//! The columns of the table. Each is tried in one direction: `from` publishes, serves or runs,
//! `to` uses it.

use std::time::Duration;

use anyhow::{Result, ensure};
use serde_json::Value;

use crate::software::{End, Software};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Capability {
    Topics,
    Latched,
    Services,
    Actions,
    Params,
    Large,
    Churn,
    Liveliness,
}

/// Limit for whatever a case waits for.
const LIMIT: Duration = Duration::from_secs(30);

/// Bytes of a large message.
const LARGE: u64 = 6_000_000;

impl Capability {
    pub const ALL: [Self; 8] = [
        Self::Topics,
        Self::Latched,
        Self::Services,
        Self::Actions,
        Self::Params,
        Self::Large,
        Self::Churn,
        Self::Liveliness,
    ];

    pub fn label(self) -> &'static str {
        match self {
            Self::Topics => "topics",
            Self::Latched => "latched",
            Self::Services => "services",
            Self::Actions => "actions",
            Self::Params => "params",
            Self::Large => "large",
            Self::Churn => "churn",
            Self::Liveliness => "liveliness",
        }
    }

    /// Why a software has no such thing, at either end.
    pub fn absent(self, software: Software) -> Option<&'static str> {
        match (self, software) {
            (Self::Services | Self::Actions | Self::Params, Software::Dust) => Some("has topics only"),
            (Self::Actions, Software::Cyclone) => Some("has no actions of ROS"),
            (Self::Params, Software::Cyclone) => Some("has no parameters of ROS"),
            (Self::Params, _) if software.is_ros1() => Some("keeps parameters at the master"),
            (Self::Liveliness, Software::Dust) => Some("matches no vendor's subscriber if it offers a lease"),
            (Self::Liveliness, _) if software.is_ros1() => Some("has no leases"),
            _ => None,
        }
    }

    /// Tries it. `name` is unused so far.
    pub fn run(self, from: &End<'_>, to: &End<'_>, name: &str) -> Result<()> {
        let topic = format!("/pair/{name}");
        match self {
            Self::Topics => topics(from, to, &topic),
            Self::Latched => latched(from, to, &topic),
            Self::Services => services(from, to, &topic),
            Self::Actions => actions(from, to, &topic),
            Self::Params => params(from, to, &topic),
            Self::Large => large(from, to, &topic),
            Self::Churn => churn(from, to, &topic),
            Self::Liveliness => liveliness(from, to, &topic),
        }
    }
}

/// Ten messages arrive, in order and unchanged.
fn topics(from: &End<'_>, to: &End<'_>, topic: &str) -> Result<()> {
    let mut listener = to.topic("listen", topic, &[])?;
    let _talker = from.topic("talk", topic, &["--rate", "20"])?;
    let messages = listener.wait_until("ten messages", LIMIT, |listener| {
        let messages = messages(&listener.json_lines());
        (messages.len() >= 10).then_some(messages)
    })?;
    ensure!(messages.iter().all(|message| message["intact"] == true), "changed: {messages:?}");
    let sequence: Vec<i64> = messages.iter().filter_map(|message| message["seq"].as_i64()).collect();
    ensure!(sequence.windows(2).all(|pair| pair[1] == pair[0] + 1), "not in order: {sequence:?}");
    Ok(())
}

/// A late subscriber gets the last message.
fn latched(from: &End<'_>, to: &End<'_>, topic: &str) -> Result<()> {
    let options = ["--transient-local", "--no-wait", "--count", "3", "--rate", "20"];
    let mut talker = from.topic("talk", topic, &options)?;
    talker.wait_event("done", LIMIT)?;
    let late: &[&str] = if to.software.is_ros1() { &[] } else { &["--transient-local"] };
    let mut listener = to.topic("listen", topic, late)?;
    listener.wait_until("the last message", LIMIT, |listener| {
        messages(&listener.json_lines()).iter().any(|message| message["seq"] == 2).then_some(())
    })
}

/// A client switches a lamp on and off.
fn services(from: &End<'_>, to: &End<'_>, service: &str) -> Result<()> {
    let _server = from.service("switch", service)?;
    let mut client = to.service("set", service)?;
    let success = client.wait_until("two responses", LIMIT, |client| {
        let lines = client.json_lines();
        let responses = lines.iter().filter(|line| line["event"] == "response");
        let success: Vec<bool> = responses.filter_map(|line| line["success"].as_bool()).collect();
        (success.len() >= 2).then_some(success)
    })?;
    ensure!(success == [true, false], "other responses: {success:?}");
    Ok(())
}

/// A goal succeeds with its whole result, and with feedback before.
fn actions(from: &End<'_>, to: &End<'_>, action: &str) -> Result<()> {
    let mut server = from.action("compute", action, "0.1")?;
    server.wait_event("ready", LIMIT)?;
    let mut client = to.action("send", action, "12")?;
    client.wait_event("feedback", LIMIT)?;
    let result = client.wait_event("result", LIMIT)?;
    ensure!(result["length"] == 12, "another result: {result}");
    Ok(())
}

/// A parameter of a node is read and changed, as `ros2 param get` and `set` do.
fn params(from: &End<'_>, to: &End<'_>, node: &str) -> Result<()> {
    // After its message the talker answers requests.
    let _node = from.topic("talk", "/pair/params", &["--node", node, "--count", "1"])?;
    let read = to.parameters(node)?.wait_event("parameters", LIMIT)?;
    ensure!(read["use_sim_time"] == serde_json::json!([false, true]), "{read}");
    Ok(())
}

/// Three messages of 6 MB arrive unchanged.
fn large(from: &End<'_>, to: &End<'_>, topic: &str) -> Result<()> {
    let mut listener = to.topic("listen", topic, &[])?;
    let _talker = from.topic("talk", topic, &["--rate", "2", "--size", &LARGE.to_string()])?;
    let messages = listener.wait_until("three large messages", LIMIT, |listener| {
        let messages = messages(&listener.json_lines());
        (messages.len() >= 3).then_some(messages)
    })?;
    let whole = |message: &Value| message["intact"] == true && message["bytes"] == LARGE;
    ensure!(messages.iter().all(whole), "changed: {messages:?}");
    Ok(())
}

/// Each of five talkers that follow one another is heard; the one before was killed.
fn churn(from: &End<'_>, to: &End<'_>, topic: &str) -> Result<()> {
    let mut listener = to.topic("listen", topic, &[])?;
    for round in 0..5 {
        let text = format!("round{round}");
        let mut talker = from.topic("talk", topic, &["--rate", "20", "--text", &text])?;
        listener.wait_until(&text, LIMIT, |listener| {
            let lines = listener.json_lines();
            let texts = lines.iter().filter_map(|line| line["text"].as_str());
            texts.into_iter().any(|heard| heard.starts_with(&text)).then_some(())
        })?;
        talker.kill()?;
    }
    Ok(())
}

/// A subscriber sees that a publisher was killed, by the lease that the publisher offers.
fn liveliness(from: &End<'_>, to: &End<'_>, topic: &str) -> Result<()> {
    let mut options = vec!["--lease", "1500"];
    if to.software == Software::Cyclone {
        options.push("--no-deadline");
    }
    let mut listener = to.topic("listen", topic, &options)?;
    let mut talker = from.topic("talk", topic, &["--rate", "20", "--lease", "1000"])?;
    let last = |lines: &[Value]| lines.iter().rev().find(|line| line["event"] == "liveliness").cloned();
    let alive = |lines: &[Value]| last(lines).and_then(|line| line["alive"].as_i64());
    let message = |lines: &[Value]| lines.iter().any(|line| line["event"] == "message");
    listener.wait_until("a live publisher", LIMIT, |listener| {
        let lines = listener.json_lines();
        (message(&lines) && alive(&lines) == Some(1)).then_some(())
    })?;
    talker.kill()?;
    // The lease of the participant would end after 10 s or more.
    listener.wait_until("its end", Duration::from_secs(8), |listener| {
        (alive(&listener.json_lines()) == Some(0)).then_some(())
    })
}

fn messages(lines: &[Value]) -> Vec<Value> {
    lines.iter().filter(|line| line["event"] == "message").cloned().collect()
}
