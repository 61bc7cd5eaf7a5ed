//! Unit tests of `config`.

use super::*;
use crate::ros2::{Durability, Qos, Reliability};

const MINIMAL: &str = "{version: 1, identity: robot.pem, links: [{to: 'eth://r0'}], topics: [{topic: /chatter, \
                       direction: out, \
                       card: chatter.card, cert: /etc/gdp/chatter.ad}]}";

#[test]
fn a_membership_is_in_files_beside_the_configuration() {
    let text = "{version: 1, identity: robot.pem, links: [{to: 'eth://r0'}], domain: {card: domain.card, membership: \
                /m, peers: [p]}}";
    let config = Config::parse(text, Path::new("/etc/gdp/proxy.yaml")).unwrap();
    let files = CredentialFiles::from(config.domain.as_ref().unwrap());
    assert_eq!(
        (files.card.as_path(), files.membership.as_path()),
        (Path::new("/etc/gdp/domain.card"), Path::new("/m"))
    );
    assert_eq!(files.peers, [Path::new("/etc/gdp/p")]);
    let wrong = Config::parse(&text.replace("peers", "peer"), Path::new("p.yaml")).unwrap_err();
    assert!(wrong.to_string().contains("peer"), "{wrong}");
}

#[test]
fn what_is_not_said_has_the_defaults_of_ros_2() {
    let config = parse(MINIMAL).unwrap();
    assert_eq!((config.links[0].switch, config.links[0].budget), (None, None));
    let topic = &config.topics[0];
    assert!(!topic.duplicate);
    assert_eq!((topic.direction, &topic.kind), (Direction::Out, &None));
    assert_eq!((topic.qos, topic.encoding, topic.max_hz, topic.priority.get()), (None, Conversion::Auto, None, 3));
    assert_eq!((topic.compression, &topic.frame_prefix), (Compression::None, &None));
    let reliable = Qos::default();
    assert_eq!((reliable.reliability, reliable.durability), (Reliability::Reliable, Durability::Volatile));
    assert_eq!(reliable.depth.get(), 10);
}

#[test]
fn a_relay_is_said_in_a_word_or_with_what_differs() {
    let relay = |says: &str| parse(&MINIMAL.replace("topics:", &format!("relay: {says}, topics:"))).unwrap().relay;
    assert!(relay("false").is_none() && parse(MINIMAL).unwrap().relay.is_none());
    let plain = relay("true").unwrap();
    assert_eq!(plain.identity, Path::new("/etc/robot/relay.pem"));
    assert_eq!((plain.membership, plain.udp), (None, "0.0.0.0:31415".parse().unwrap()));
    let other = relay("{udp: '[::]:9', interfaces: [r1]}").unwrap();
    assert_eq!((other.udp, other.interfaces), ("[::]:9".parse().unwrap(), vec!["r1".to_owned()]));
    let member = relay("true, domain: {card: c, membership: m}").unwrap();
    assert_eq!(member.membership.as_deref(), Some(Path::new("/etc/robot/relay.member")));
}

#[test]
fn paths_are_relative_to_the_file() {
    let config = parse(MINIMAL).unwrap();
    assert_eq!(config.identity, Path::new("/etc/robot/robot.pem"));
    assert_eq!(config.topics[0].card, Path::new("/etc/robot/chatter.card"));
    assert_eq!(config.topics[0].right(Side::Out), Some(Path::new("/etc/gdp/chatter.ad")));
}

#[test]
fn everything_can_be_said() {
    let name = "1234e5".repeat(11)[..64].to_owned();
    let text = format!(
        "version: 1\nidentity: a.pem\nlinks:\n  - to: udp://127.0.0.1:31415%wlan0\n    switch: {name}\n  - {{to: \
         eth://r0, budget: 250000}}\n\
         graphs: {{car: {{domain_id: 42}}}}\ntopics:\n  - topic: /a/b\n    type: sensor_msgs/msg/Image\n\
         \x20   direction: in\n    card: c\n    grant: d\n    duplicate: true\n    compression: zstd\n\
         \x20   frame_prefix: robot1/\n    qos: {{reliability: best_effort, \
         durability: transient_local, depth: 3}}\n"
    );
    let config = parse(&text).unwrap();
    let [first, second] = &config.links[..] else { panic!("{:?}", config.links) };
    assert_eq!((first.switch.unwrap().to_string(), first.to.to_string()), (name, "udp://127.0.0.1:31415%wlan0".into()));
    assert_eq!(LinkConfig::from(second).budget, Some(250_000));
    let (name, graph) = config.graphs.get(None).unwrap();
    let domain_id = DomainId::try_from(42).unwrap();
    assert_eq!((name, graph), ("car", &GraphConfig::Ros2(Ros2Config { domain_id })));
    let topic = &config.topics[0];
    assert_eq!(topic.kind.as_ref().unwrap().as_str(), "sensor_msgs/msg/Image");
    assert_eq!((topic.direction, topic.duplicate), (Direction::In, true));
    assert_eq!((topic.compression, topic.frame_prefix.as_ref().unwrap().as_str()), (Compression::Zstd, "robot1/"));
    let qos = topic.qos.unwrap();
    assert_eq!((qos.reliability, qos.depth.get()), (Reliability::BestEffort, 3));
    assert_eq!(qos.durability, Durability::TransientLocal);
}

#[test]
fn the_example_is_a_configuration() {
    let config = parse(include_str!("../../example.yaml")).unwrap();
    assert_eq!(config.topics.iter().map(|t| t.direction).collect::<Vec<_>>(), [Direction::Out, Direction::In]);
}

#[test]
fn nothing_is_exposed_by_default() {
    assert!(parse("{version: 1, identity: a.pem, links: [{to: 'eth://r0'}]}").unwrap().topics.is_empty());
}

/// Each refusal names the file, and what is wrong.
#[test]
fn what_is_wrong_is_refused_and_named() {
    let cases = [
        ("", "unexpected end of input"),
        ("{version: 1, links: [{to: 'eth://r0'}]}", "identity"),
        ("{version: 1, identity: a.pem}", "links"),
        ("{version: 1, identity: a.pem, links: []}", "links: 0 of them"),
        (&format!("{{version: 1, identity: a.pem, links: [{}]}}", "{to: 'eth://r0'}, ".repeat(5)), "links: 5 of them"),
        (
            "{version: 1, identity: a.pem, links: [{to: 'eth://r0'}, {to: 'eth://r0'}]}",
            "links[1].to: eth://r0 is already links[0]",
        ),
        (&MINIMAL.replace("links:", "lnks:"), "lnks"),
        (&MINIMAL.replace("to:", "via:"), "via"),
        (&MINIMAL.replace("to: 'eth://r0'", "to: 'eth://r0', budget: 0"), "nonzero"),
        (&MINIMAL.replace("direction:", "duplicate: true, direction:"), "topics[0].duplicate: there is no second link"),
        (&MINIMAL.replace("direction:", "duplicate: twice, direction:"), "boolean"),
        (&MINIMAL.replace("eth://r0", "tcp://r0"), "is no link"),
        (&MINIMAL.replace("cert:", "certs:"), "certs"),
        (&MINIMAL.replace("cert:", "key: chatter.key, cert:"), "no `key` any more"),
        (
            &MINIMAL.replace("cert:", "readers: [robot], cert:"),
            "`readers` is a key of `expose` alone, for which the proxy has an owner's key",
        ),
        (&MINIMAL.replace("cert:", "readers: [robot], cert:"), "gdp-ctl grant add --read"),
        (
            &MINIMAL.replace("cert:", "meta: {site: hall}, cert:"),
            "`meta` is a key of `expose` alone, for which the proxy makes the name cards",
        ),
        (&MINIMAL.replace("cert:", "meta: {site: hall}, cert:"), "gdp-ctl name create --meta"),
        (
            &MINIMAL.replace("direction:", "compression: gzip, direction:"),
            "there is no value `gzip`; there is none, zstd",
        ),
        (&MINIMAL.replace("direction:", "frame_prefix: '', direction:"), "is empty; leave it out"),
        (&MINIMAL.replace("direction:", "frame_prefix: /r1/, direction:"), "begins with a slash"),
        (&MINIMAL.replace("direction:", "frame_prefix: 'r 1/', direction:"), "has blanks"),
        (&MINIMAL.replace("direction:", &format!("frame_prefix: {}, direction:", "r".repeat(129))), "longer than 128"),
        (
            &MINIMAL.replace("direction: out", "direction: both, grant: g, frame_prefix: r1/"),
            "topics[0].frame_prefix: with direction: both",
        ),
        (&MINIMAL.replace("direction: out", "direction: up"), "up"),
        (&MINIMAL.replace("direction: out", "direction: both"), "topics[0].grant: missing"),
        (&MINIMAL.replace("direction: out", "direction: in"), "topics[0].grant: missing"),
        (&MINIMAL.replace("cert:", "grant: g, cert:"), "topics[0].grant: is for the other direction"),
        (&MINIMAL.replace("direction:", "priority: 8, direction:"), "no priority 8"),
        (&MINIMAL.replace("direction:", "max_hz: 0, direction:"), "nonzero"),
        (&MINIMAL.replace("direction:", "encoding: xml, direction:"), "xml"),
        (&MINIMAL.replace("direction:", "graph: lab, direction:"), "topics[0].graph: there is no graph lab"),
        (
            &MINIMAL.replace("topics:", "graphs: {a: {domain_id: 1}, b: {master: 'http://b:11311'}}, topics:"),
            "topics[0].graph: missing, and there are several graphs: write one of a, b",
        ),
        (&MINIMAL.replace("topics:", "graphs: {}, topics:"), "0 graphs"),
        (&MINIMAL.replace("topics:", "graphs: {a: {domain: 1}}, topics:"), "domain"),
        (&MINIMAL.replace("topics:", "graphs: {a: {}}, topics:"), "a graph is one of ROS 2"),
        (&MINIMAL.replace("topics:", "graphs: {a: {zenoh: 'tcp/a:1', host: b}}, topics:"), "a graph is one of ROS 2"),
        (&MINIMAL.replace("topics:", "graphs: {a: {zenoh: 'udp/a:7447'}}, topics:"), "tcp/HOST:7447"),
        (&MINIMAL.replace("topics:", "graphs: {a: {zenoh: 'tcp/a'}}, topics:"), "tcp/HOST:7447"),
        (&MINIMAL.replace("topics:", "graphs: {a: {zenoh: 'tcp/\"]:7447'}}, topics:"), "tcp/HOST:7447"),
        (&MINIMAL.replace("version: 1", "version: 2"), "version 2"),
        (&MINIMAL.replace("version: 1, ", ""), "version"),
        (&MINIMAL.replace("/chatter", "chatter"), "leading slash"),
        (&MINIMAL.replace("direction:", "type: std_msgs/String, direction:"), "package/msg/Name"),
        (&MINIMAL.replace("direction:", "qos: {depth: 0}, direction:"), "a depth of 0"),
        (&MINIMAL.replace("direction:", "qos: {reliability: maybe}, direction:"), "maybe"),
        (&MINIMAL.replace("direction:", "qos: {lifespan: 1}, direction:"), "lifespan"),
        (&MINIMAL.replace("topics:", "graphs: {a: {domain_id: 233}}, topics:"), "ROS_DOMAIN_ID"),
        (&MINIMAL.replace("topics:", "relay: maybe, topics:"), "true, false, or a mapping"),
        (&MINIMAL.replace("topics:", "relay: {upd: '[::]:1'}, topics:"), "upd"),
        (&MINIMAL.replace("topics:", "relay: {membership: m}, topics:"), "relay.membership: there is no domain"),
        (&MINIMAL.replace("to:", "switch: 75e1, to:"), "64 hex digits"),
        (&MINIMAL.replace("links:", "identity: b.pem, links:"), "identity"),
        ("[", "robot.yaml"),
    ];
    for (text, expected) in cases {
        let refusal = parse(text).unwrap_err().to_string();
        assert!(refusal.starts_with("/etc/robot/robot.yaml: ") && refusal.contains(expected), "{text}\n{refusal}");
    }
}

#[test]
fn a_secret_given_by_mistake_is_not_shown() {
    let secret = "48d8213db8363f046333e2cf07e9829ee40dd8e94122a74f3d5e0e5b1d7aa5ca";
    let key = format!("kind: proxy\n-----BEGIN PRIVATE KEY-----\n{secret}\n-----END PRIVATE KEY-----\n");
    for (text, expected) in [(secret, "line 1"), (&key, "it is a private key, not a proxy configuration")] {
        let refusal = parse(text).unwrap_err().to_string();
        assert!(refusal.contains(expected) && !refusal.contains(&secret[..8]), "{refusal}");
    }
}

#[test]
fn a_topic_is_listed_once_per_direction() {
    let both = MINIMAL.replace("direction: out", "direction: both, grant: g");
    let topic = &MINIMAL[MINIMAL.find("{topic").unwrap()..MINIMAL.len() - 2];
    let twice = |second: &str| MINIMAL.replace(topic, &format!("{topic}, {second}"));
    let refusal = parse(&twice(topic)).unwrap_err().to_string();
    assert!(refusal.contains("topics[1].topic: /chatter is already topics[0]"), "{refusal}");
    let inwards = topic.replace("out", "in").replace("cert", "grant");
    assert_eq!(parse(&twice(&inwards)).unwrap().topics.len(), 2);
    assert!(parse(&both.replace("topics: [", &format!("topics: [{inwards}, "))).is_err());
}

#[test]
fn a_missing_or_endless_file_is_refused() {
    let missing = Config::load(Path::new("/nonexistent/robot.yaml")).unwrap_err().to_string();
    assert_eq!(missing, "/nonexistent/robot.yaml: cannot be read: there is no such file in /nonexistent");
    assert!(matches!(Config::load(Path::new("/dev/zero")), Err(ConfigError::TooLong(_))));
}

fn parse(text: &str) -> Result<Config, ConfigError> {
    Config::parse(text, Path::new("/etc/robot/robot.yaml"))
}
