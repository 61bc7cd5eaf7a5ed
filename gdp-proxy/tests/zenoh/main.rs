//! Graphs of rmw_zenoh, with nodes of zenoh-ros2-sdk at a router of eclipse-zenoh, joined by a
//! switch with rclpy nodes in DDS domains: on loopback and without root.
//!
//! ```text
//!    zenoh-ros2-sdk ── router ── proxy ── switch, RIB ── proxy ── rclpy on DDS, or a router
//! ```

mod actions;
#[path = "../hub/mod.rs"]
mod hub;
#[allow(dead_code, reason = "the tests of vendors, whose it is, use the rest")]
#[path = "../vendors/peer.rs"]
mod peer;
#[allow(dead_code, reason = "the tests of topics, whose it is, use the rest")]
#[path = "../bridge/site.rs"]
mod site;

use gdp_tests::dds_domain::lease;
use std::time::{Duration, Instant};

use gdp_proxy::ros2::{Domain, TopicName, TypeName};
use gdp_ros::roster::Offer;
use peer::{Peer, Vendor, within};
use serde_json::Value;
use site::{Proxy, Site};

/// RIHS01 of std_msgs/msg/String, as ROS 2 states it.
const STRING: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
const OUT: &str = "direction: out";
const IN: &str = "direction: in";

/// Time after which proxies of one graph have agreed which of them carries.
const ELECTION: Duration = Duration::from_secs(4);

#[tokio::test(flavor = "multi_thread")]
async fn a_topic_crosses_from_zenoh_to_dds() {
    let site = Site::start().await;
    let (router, domain) = (Router::start().await, lease());
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let _out = site.proxy("robot", &router.graph(), &topics, OUT);
    let _in = site.proxy("cloud", &dds(domain), &topics, IN);
    let talker = router.node("talk", &["--node", "driver", "--namespace", "/robot"]);
    let mut listener = Peer::topic(Vendor::Rclpy, "listen", domain, &[]);
    let mut last = -1;
    for _ in 0..20 {
        let message = listener.event("message").await;
        assert_eq!((&message["text"], &message["intact"]), (&"hello from zenoh".into(), &true.into()), "{message}");
        let number = message["seq"].as_i64().unwrap();
        assert!(number > last, "{number} came after {last}");
        last = number;
    }
    let mut graph = Peer::graph(domain, None);
    // ROS announces the nodes of a participant after its endpoints.
    let is_of_driver = |graph: &Value| graph["topics"]["/chatter"][0]["node"] == "/robot/driver";
    let publishers = until_graph(&mut graph, is_of_driver).await["topics"]["/chatter"].clone();
    assert_eq!(publishers[0]["hash"], STRING, "{publishers}");
    assert_eq!(publishers.as_array().map(Vec::len), Some(1), "{publishers}");

    drop(talker);
    until_graph(&mut graph, |graph| graph["topics"]["/chatter"].as_array().is_none_or(Vec::is_empty)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_topic_crosses_from_dds_to_zenoh() {
    let site = Site::start().await;
    let (router, domain) = (Router::start().await, lease());
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let _out = site.proxy("robot", &dds(domain), &topics, OUT);
    let _in = site.proxy("cloud", &router.graph(), &topics, IN);
    let mut watch = router.node("watch", &[]);
    let mut listener = router.node("listen", &["--node", "listener"]);
    let _talker = Peer::topic(Vendor::Rclpy, "talk", domain, &["--node", "/robot/driver"]);
    for _ in 0..20 {
        let message = listener.event("message").await;
        assert_eq!(message["intact"], true, "{message}");
    }
    // As the real rmw_zenoh has it.
    let kind = "std_msgs::msg::dds_::String_";
    let rest = format!("/MP/%/%robot/driver/%chatter/{kind}/{STRING}/::,10:,:,:,,");
    let token = event_with(&mut watch, "token", "token", &rest).await;
    assert!(token["token"].as_str().unwrap().starts_with("@ros2_lv/0/"), "{token}");
    let data = watch.event("data").await;
    assert_eq!(data["key"], format!("0/chatter/{kind}/{STRING}"));
    let attachment = data["attachment"].as_str().unwrap();
    assert_eq!((attachment.len(), &attachment[32..34]), (66, "10"), "{attachment}");

    drop(_out);
    let end = event_with(&mut watch, "end", "token", &rest).await;
    assert_eq!(end["token"], token["token"], "its publisher leaves with the proxy that announced it");
}

#[tokio::test(flavor = "multi_thread")]
async fn late_subscribers_receive_latched_messages_both_ways() {
    let site = Site::start().await;
    let (router, other, domain) = (Router::start().await, Router::start().await, lease());
    let to_dds = [site.topic("/map", "std_msgs/msg/String")];
    let to_zenoh = [site.topic("/plan", "std_msgs/msg/String")];
    let _proxies = [
        site.proxy("a", &router.graph(), &to_dds, OUT),
        site.proxy("b", &dds(domain), &to_dds, IN),
        site.proxy("c", &dds(domain), &to_zenoh, OUT),
        site.proxy("d", &other.graph(), &to_zenoh, IN),
    ];
    let latch = ["--topic", "/map", "--node", "mapper", "--text", "a map"];
    let mut mapper = router.node("latch", &latch);
    mapper.event("ready").await;
    let options = ["--topic", "/map", "--transient-local"];
    for _ in 0..2 {
        let mut late = Peer::topic(Vendor::Rclpy, "listen", domain, &options);
        let message = late.event("message").await;
        assert_eq!((&message["text"], &message["intact"]), (&"a map".into(), &true.into()), "{message}");
    }
    let options = ["--topic", "/plan", "--transient-local", "--count", "1", "--text", "a plan"];
    let _planner = Peer::topic(Vendor::Rclpy, "talk", domain, &options);
    for name in ["early", "later"] {
        let mut late = other.node("late", &["--topic", "/plan", "--node", name]);
        let message = late.event("message").await;
        assert!(message["text"].as_str().unwrap().starts_with("a plan"), "{message}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn services_are_called_both_ways_and_leave() {
    let site = Site::start().await;
    let (router, domain) = (Router::start().await, lease());
    let _proxies = services_both_ways(&site, &router, domain);
    let light = router.node("switch", &["--service", "/light", "--node", "light"]);
    let mut client = Peer::rclpy_service("set", domain, "/light");
    responses(&mut client, "/light").await;
    drop(light);
    client.event("gone").await;

    let _fan = Peer::rclpy_service("switch", domain, "/fan");
    responses(&mut router.node("set", &["--service", "/fan", "--node", "client"]), "/fan").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_hostile_nodes_publish_is_dropped_and_counted() {
    let site = Site::start().await;
    let (router, other) = (Router::start().await, Router::start().await);
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let out = site.proxy("robot", &router.graph(), &topics, OUT);
    let _in = site.proxy("cloud", &other.graph(), &topics, IN);
    let mut watch = other.node("watch", &[]);
    let mut listener = other.node("listen", &["--node", "listener"]);
    let hostile = router.node("hostile", &["--node", "hostile"]);
    for _ in 0..50 {
        let message = listener.event("message").await;
        assert_eq!((&message["text"], &message["intact"]), (&"good".into(), &true.into()), "{message}");
        let data = watch.event("data").await;
        assert_eq!(data["attachment"].as_str().map(str::len), Some(66), "{data}");
    }
    let unreadable = || out.topics()[0]["drops"]["unreadable"].as_u64().unwrap_or_default();
    assert!(until(|| unreadable() > 500).await, "{:?}", out.topics());
    // A client's request without an attachment, or in no CDR, would be the same.
    drop(hostile);
    let log = site.log("robot");
    assert!(log.contains("liveliness token"), "{log}");
    assert!(log.lines().count() < 60, "{log}");
    assert_eq!(out.statuses(), ["up"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn broken_requests_and_responses_end_no_service() {
    let site = Site::start().await;
    let (router, domain) = (Router::start().await, lease());
    let _proxies = services_both_ways(&site, &router, domain);
    let _fan = Peer::rclpy_service("switch", domain, "/fan");
    let mut hostile = router.node("misanswer", &["--service", "/light", "/fan", "--node", "hostile"]);
    hostile.event("ready").await;
    responses(&mut Peer::rclpy_service("set", domain, "/light"), "/light").await;
    responses(&mut router.node("set", &["--service", "/fan", "--node", "client"]), "/fan").await;
    assert!(until(|| site.log("d").contains("a request of a Zenoh client is refused")).await, "{}", site.log("d"));
    assert!(site.log("d").lines().count() < 40, "{}", site.log("d"));
}

#[tokio::test(flavor = "multi_thread")]
async fn two_proxies_of_a_graph_do_not_carry_each_others_messages() {
    let site = Site::start().await;
    let (here, there) = (Router::start().await, Router::start().await);
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let proxies = [("a", &here), ("b", &here), ("c", &there)]
        .map(|(label, router)| site.proxy(label, &router.graph(), &topics, "direction: both"));
    // A takeover repeats messages. So the same one has stood by for longer than an election takes.
    let stands_by = |status: &String| status.contains("standing by");
    let idle = || proxies[..2].iter().position(|proxy| proxy.statuses().iter().all(stands_by));
    let (mut settled, mut since) = (None, Instant::now());
    let is_settled = || {
        if settled.is_none() || idle() != settled {
            (settled, since) = (idle(), Instant::now());
        }
        settled.is_some() && since.elapsed() > ELECTION
    };
    assert!(until(is_settled).await);
    let mut listeners = [&here, &there].map(|router| router.node("listen", &["--node", "listener"]));
    for listener in &mut listeners {
        listener.event("ready").await;
    }
    let _talkers = [(&here, "here"), (&there, "there")]
        .map(|(router, text)| router.node("talk", &["--node", text, "--text", text]));
    for listener in &mut listeners {
        let mut last = [("here", -1), ("there", -1)];
        while last.iter().any(|(_, number)| *number < 40) {
            let message = listener.event("message").await;
            let (who, number) = (message["text"].as_str().unwrap(), message["seq"].as_i64().unwrap());
            let (_, before) = last.iter_mut().find(|(name, _)| *name == who).unwrap();
            assert!(number > *before, "{who} {number} came after {before}");
            *before = number;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_one_proxy_publishes_in_a_graph_another_does_not_carry_on() {
    let site = Site::start().await;
    let routers = [Router::start().await, Router::start().await, Router::start().await];
    let (first, second) =
        ([site.topic("/chatter", "std_msgs/msg/String")], [site.topic("/chatter", "std_msgs/msg/String")]);
    let _proxies = [
        site.proxy("a", &routers[0].graph(), &first, OUT),
        site.proxy("b", &routers[1].graph(), &first, IN),
        site.proxy("c", &routers[1].graph(), &second, OUT),
        site.proxy("d", &routers[2].graph(), &second, IN),
    ];
    let [mut between, mut last] =
        [&routers[1], &routers[2]].map(|router| router.node("listen", &["--node", "listener"]));
    let _far = routers[0].node("talk", &["--node", "far", "--text", "far"]);
    for _ in 0..20 {
        assert_eq!(between.event("message").await["text"], "far");
    }
    let _near = routers[1].node("talk", &["--node", "near", "--text", "near"]);
    for _ in 0..20 {
        assert_eq!(last.event("message").await["text"], "near");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_router_may_start_later_and_again() {
    let site = Site::start().await;
    let (port, domain) = (free_port(), lease());
    let carried = [site.topic("/chatter", "std_msgs/msg/String"), site.name("service", "/fan", "std_srvs/srv/SetBool")];
    let graph = format!("{{zenoh: 'tcp/127.0.0.1:{port}', domain_id: 0}}");
    let _out = site.proxy("robot", &dds(domain), &carried, OUT);
    let _in = site.proxy_of("cloud", &graph, &carried, IN, "diagnostics: true");
    let _talker = Peer::topic(Vendor::Rclpy, "talk", domain, &[]);
    let _fan = Peer::rclpy_service("switch", domain, "/fan");
    let is_waiting = until(|| site.log("cloud").contains("not reached")).await;
    assert!(is_waiting, "{}", site.log("cloud"));
    for _ in 0..2 {
        let router = Router::at(port).await;
        let mut watch = router.node("watch", &[]);
        let mut listener = router.node("listen", &["--node", "listener"]);
        for _ in 0..5 {
            assert_eq!(listener.event("message").await["intact"], true);
        }
        responses(&mut router.node("set", &["--service", "/fan", "--node", "client"]), "/fan").await;
        within("diagnostics", async {
            while !watch.event("data").await["key"].as_str().unwrap().starts_with("0/diagnostics/") {}
        })
        .await;
    }
    let log = site.log("cloud");
    assert!(log.contains("not reached") && log.contains("joined a graph of rmw_zenoh"), "{log}");
    assert!(log.lines().filter(|line| line.contains("not reached")).count() < 5, "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_type_whose_hash_nobody_knows_is_refused() {
    let site = Site::start().await;
    let (router, domain) = (Router::start().await, lease());
    let topics = [site.topic("/odd", "odd_msgs/msg/Odd")];
    let _out = site.proxy("robot", &dds(domain), &topics, OUT);
    let cloud = site.proxy("cloud", &router.graph(), &topics, IN);
    let participant = Domain::join(domain, "odd").unwrap();
    let (topic, kind) = (TopicName::parse("/odd").unwrap(), TypeName::parse("odd_msgs/msg/Odd").unwrap());
    let _writer = participant.writer(&topic, &kind, &Offer::DEFAULT).unwrap();
    let status = || cloud.statuses().first().cloned().unwrap_or_default();
    let is_refused = until(|| status().contains("the hash of odd_msgs/msg/Odd is not known")).await;
    assert!(is_refused, "{} {}", status(), site.log("cloud"));
    participant.leave().await;
}

/// A router, as a program that ends with the test.
struct Router {
    port: u16,
    _router: Peer,
}

impl Router {
    async fn start() -> Self {
        Self::at(free_port()).await
    }

    async fn at(port: u16) -> Self {
        let mut router = Peer::python("zenoh_ros.py", &["router", "--port", &port.to_string()]);
        router.event("ready").await;
        Self { port, _router: router }
    }

    fn graph(&self) -> String {
        format!("{{zenoh: 'tcp/127.0.0.1:{}', domain_id: 0}}", self.port)
    }

    fn node(&self, verb: &str, options: &[&str]) -> Peer {
        let port = self.port.to_string();
        Peer::python("zenoh_ros.py", &[&[verb, "--port", &port], options].concat())
    }

    fn action(&self, verb: &str, options: &[&str]) -> Peer {
        let port = self.port.to_string();
        Peer::python("zenoh_action.py", &[&[verb, "--port", &port], options].concat())
    }
}

fn dds(domain: u16) -> String {
    format!("{{domain_id: {domain}}}")
}

fn free_port() -> u16 {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

async fn responses(client: &mut Peer, service: &str) {
    for (success, word) in [(true, "on"), (false, "off")] {
        let response = client.event("response").await;
        let message = format!("{service} is {word}");
        assert_eq!((&response["success"], &response["message"]), (&success.into(), &message.into()), "{response}");
    }
}

/// The next event whose text ends so.
async fn event_with(peer: &mut Peer, event: &str, key: &str, end: &str) -> Value {
    let found = async {
        loop {
            let line = peer.event(event).await;
            if line[key].as_str().unwrap().ends_with(end) {
                return line;
            }
        }
    };
    within(end, found).await
}

/// Proxies that carry `/light` from the graph of the router to the domain, and `/fan` back: a to b,
/// and c to d.
fn services_both_ways(site: &Site, router: &Router, domain: u16) -> [Proxy; 4] {
    let there = [site.name("service", "/light", "std_srvs/srv/SetBool")];
    let back = [site.name("service", "/fan", "std_srvs/srv/SetBool")];
    [
        site.proxy("a", &router.graph(), &there, OUT),
        site.proxy("b", &dds(domain), &there, IN),
        site.proxy("c", &dds(domain), &back, OUT),
        site.proxy("d", &router.graph(), &back, IN),
    ]
}

async fn until_graph(graph: &mut Peer, is_so: impl Fn(&Value) -> bool) -> Value {
    let found = async {
        loop {
            let seen = graph.event("graph").await;
            if is_so(&seen) {
                return seen;
            }
        }
    };
    within("a graph", found).await
}

async fn until(mut is_so: impl FnMut() -> bool) -> bool {
    for _ in 0..600 {
        if is_so() {
            return true;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    false
}
