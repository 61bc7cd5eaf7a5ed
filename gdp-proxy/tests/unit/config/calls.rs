//! Unit tests of `config::calls`.

use std::path::Path;

use super::*;
use crate::config::{Config, ConfigError};

const SERVICE: &str = "services: [{service: /light, direction: out, card: c, cert: light.ad}]";
const ACTION: &str = "actions: [{action: /dock, direction: in, card: c, grant: dock.grant}]";

fn parse(calls: &str) -> Result<Config, ConfigError> {
    let text = format!("{{version: 1, identity: i, links: [{{to: 'eth://r0'}}], {calls}}}");
    Config::parse(&text, Path::new("/etc/gdp/p.yaml"))
}

#[test]
fn services_and_actions_are_read_and_their_files_lie_beside() {
    let config = parse(&format!("{SERVICE}, {ACTION}")).unwrap();
    let calls: Vec<_> = config.calls().collect();
    let [(first, light), (second, dock)] = &calls[..] else { panic!("{calls:?}") };
    assert_eq!((first.as_str(), second.as_str()), ("services[0]", "actions[0]"));
    assert_eq!((light.what, light.side, dock.what, dock.side), (What::Service, Side::Out, What::Action, Side::In));
    assert_eq!(dock.right(), ("grant", Some(&PathBuf::from("/etc/gdp/dock.grant"))));
    parse(&format!("graphs: {{a: {{master: 'http://b:11311'}}}}, {ACTION}")).unwrap();
    assert!(light.kind.is_none() && parse("").unwrap().calls().next().is_none());
}

#[test]
fn a_call_goes_to_one_server_unless_more_are_wanted() {
    let replicated = SERVICE.replace("direction: out", "direction: in, replicate: 3").replace("cert:", "grant:");
    for (text, copies) in [(&replicated[..], 3), (SERVICE, 1), (ACTION, 1)] {
        assert_eq!(parse(text).unwrap().calls().next().unwrap().1.copies(), copies, "{text}");
    }
}

/// Each refusal names the key, and what is wrong.
#[test]
fn what_is_wrong_is_refused_and_named() {
    let twice = "[{service: /a, direction: out, card: c, cert: d}, {service: /a, direction: in, card: c, grant: d}]";
    let inward = |said: &str| format!("services: [{{service: /a, direction: in, card: c, grant: d, {said}}}]");
    let cases = [
        (SERVICE.replace("service: /light", "topic: /light"), "topic"),
        (SERVICE.replace("direction: out", "direction: both"), "both"),
        (SERVICE.replace("direction: out", "direction: in"), "services[0].grant: missing"),
        (ACTION.replace("direction: in", "direction: out"), "actions[0].cert: missing"),
        (SERVICE.replace("cert:", "grant: g, cert:"), "services[0].grant: is for the other direction"),
        (SERVICE.replace("card:", "qos: {depth: 1}, card:"), "qos"),
        (
            SERVICE.replace("card:", "type: std_msgs/msg/String, card:"),
            "services[0].type: std_msgs/msg/String is no type",
        ),
        (ACTION.replace("card:", "type: a/srv/B, card:"), "write it as package/action/Name"),
        (SERVICE.replace("card:", "graph: lab, card:"), "services[0].graph: there is no graph lab"),
        (SERVICE.replace("card:", "replicate: 2, card:"), "services[0].replicate: is for direction: in"),
        (ACTION.replace("card:", "replicate: 2, card:"), "actions[0].replicate: is for services only"),
        (inward("replicate: 1"), "services[0].replicate: a call goes to 2 to 8 servers at once, and not to 1"),
        (inward("replicate: 9"), "services[0].replicate: a call goes to 2 to 8 servers at once, and not to 9"),
        (format!("services: {twice}"), "services[1].service: /a is already services[0]"),
    ];
    for (text, says) in cases {
        let refusal = parse(&text).expect_err(&text).to_string();
        assert!(refusal.contains(says), "{text}: {refusal}");
    }
}
