//! Proxies in ROS graphs of both versions, with real rospy nodes at real masters, joined by a
//! switch: on loopback and without root.
//!
//! ```text
//!    rospy ── proxy ── switch, RIB ── proxy ── rospy, or DDS
//! ```

mod actionlib;
mod admin;
mod automatic;
mod crypto;
mod direct;
mod floods;
mod frames;
mod graph_view;
#[path = "../hub/mod.rs"]
mod hub;
mod latched;
mod liveliness;
mod lives;
#[allow(dead_code, reason = "the tests of the ROS 1 node, whose it is, use the rest")]
#[path = "../../../crates/gdp-ros1/tests/rospy/master.rs"]
mod master;
mod merging;
#[allow(dead_code, reason = "the tests of vendors, whose it is, use the rest")]
#[path = "../vendors/peer.rs"]
mod peer;
#[allow(dead_code, reason = "the tests of services, which use the site as well, use the rest")]
mod site;
mod twins;

use gdp_tests::dds_domain::lease;
use std::time::Duration;

use bytes::Bytes;
use gdp_e2e::seal::Encoding;
use gdp_proxy::ros2::{Domain, RawSample, TopicName, TypeName};
use gdp_ros::roster::Offer;

use master::{Master, Process};
use site::Site;

const RELIABLE: Offer = Offer::DEFAULT;
const LATCHED: Offer = Offer { transient_local: true, depth: 1, ..RELIABLE };

#[tokio::test(flavor = "multi_thread")]
async fn what_rospy_says_at_one_master_rospy_hears_at_another() {
    let site = Site::start().await;
    let (here, there) = (Master::start().await, Master::start().await);
    let topics = [site.topic("/chatter", "std_msgs/msg/String"), site.topic("/latched", "std_msgs/msg/String")];
    let out = site.proxy("robot", &graph(&here), &topics, "direction: out");
    let _in = site.proxy("cloud", &graph(&there), &topics, "direction: in");

    let _talker = here.begin("talker", &["publish", "/chatter", "hello"]);
    let mut listener = there.begin("listener", &["listen", "/chatter"]);
    let heard = listener.event("message").await;
    assert!(heard["data"].as_str().unwrap().starts_with("hello "), "{heard}");
    assert!(heard["caller"].as_str().unwrap().starts_with("/gdp_proxy_"), "{heard}");

    // Each publisher's last message is for everybody who comes later.
    let _robots = ["one", "two", "three"].map(|robot| here.begin(robot, &["latch", "/latched", robot]));
    let mut early = there.begin("early", &["listen", "/latched"]);
    assert_eq!(texts(&mut early, 3).await, ["one", "three", "two"]);
    let mut late = there.begin("late", &["listen", "/latched"]);
    assert_eq!(texts(&mut late, 3).await, ["one", "three", "two"]);

    // Also for a proxy that comes later, and once the publishers have gone for nobody.
    drop(_in);
    let third = Master::start().await;
    let _in = site.proxy("cloud", &graph(&third), &topics, "direction: in");
    let mut latest = third.begin("latest", &["listen", "/latched"]);
    assert_eq!(texts(&mut latest, 3).await, ["one", "three", "two"]);
    drop(out);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_one_ros_version_says_the_other_understands_both_ways() {
    let site = Site::start().await;
    let (master, domain) = (Master::start().await, lease());
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let back = [site.topic("/answers", "std_msgs/msg/String")];
    let (to, fro) = (&graph(&master), &format!("{{domain_id: {domain}}}"));
    let _proxies = [
        site.proxy("a", to, &topics, "direction: out"),
        site.proxy("b", fro, &topics, "direction: in"),
        site.proxy("c", fro, &back, "direction: out"),
        site.proxy("d", to, &back, "direction: in"),
    ];
    let participant = Domain::join(domain, "graph_observer").unwrap();
    let kind = TypeName::parse("std_msgs/msg/String").unwrap();
    let topic = |name: &str| TopicName::parse(name).unwrap();

    let _talker = master.begin("talker", &["publish", "/chatter", "hello"]);
    let reader = participant.reader(&topic("/chatter"), &kind, &RELIABLE).unwrap();
    let heard = within("a message of rospy", reader.recv()).await.unwrap().sample.bytes;
    assert!(heard[..4] == [0, 1, 0, 0] && text(&heard).starts_with("hello "), "{heard:?}");

    let mut writer = participant.writer(&topic("/answers"), &kind, &LATCHED).unwrap();
    writer.write(cdr("good morning"), 0).await.unwrap();
    let mut listener = master.begin("listener", &["listen", "/answers"]);
    assert_eq!(texts(&mut listener, 1).await, ["good morning"]);
    let mut late = master.begin("late", &["listen", "/answers"]);
    assert_eq!(texts(&mut late, 1).await, ["good morning"], "latched, as the writer in DDS does it");
    participant.leave().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_both_sites_say_each_hears_once() {
    let site = Site::start().await;
    let (here, there) = (Master::start().await, Master::start().await);
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let _proxies = [("robot", &here), ("cloud", &there)]
        .map(|(label, master)| site.proxy(label, &graph(master), &topics, "direction: both"));
    let mut listeners = [&here, &there].map(|master| master.begin("listener", &["listen", "/chatter"]));
    for listener in &mut listeners {
        listener.event("ready").await;
    }
    let _talkers = [(&here, "here"), (&there, "there")]
        .map(|(master, text)| master.begin("talker", &["publish", "/chatter", text]));
    for listener in &mut listeners {
        let mut last = [("here", -1), ("there", -1)];
        while last.iter().any(|(_, number)| *number < 40) {
            let message = listener.event("message").await;
            let (who, number) = message["data"].as_str().unwrap().split_once(' ').unwrap();
            let number = number.parse().unwrap();
            let (_, before) = last.iter_mut().find(|(name, _)| *name == who).unwrap();
            assert!(number > *before, "{who} {number} came after {before}");
            *before = number;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_go_as_json_if_that_is_wanted_and_no_faster_than_is_wanted() {
    let site = Site::start().await;
    let master = Master::start().await;
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let _proxy = site.proxy("robot", &graph(&master), &topics, "direction: out, encoding: json, max_hz: 2");
    let mut subscription = site.subscribe(&topics[0]).await;
    let _talker = master.begin("talker", &["publish", "/chatter", "hello"]);
    let mut stamps = Vec::new();
    while stamps.len() < 4 {
        let message = within("a message", subscription.recv()).await.unwrap();
        if message.encoding == Encoding::Json {
            let value: serde_json::Value = serde_json::from_slice(&message.body).unwrap();
            assert!(value["data"].as_str().unwrap().starts_with("hello "), "{value}");
            stamps.push(message.timestamp_ns);
        }
    }
    assert!(stamps[3] - stamps[0] > 1_000_000_000, "20 a second are published: {stamps:?}");
}

/// So many different texts, sorted.
async fn texts(listener: &mut Process, count: usize) -> Vec<String> {
    let mut texts = std::collections::BTreeSet::new();
    while texts.len() < count {
        texts.insert(listener.event("message").await["data"].as_str().unwrap().to_owned());
    }
    texts.into_iter().collect()
}

/// A master, as a configuration says it.
fn graph(master: &Master) -> String {
    let config = master.config("/unused");
    format!("{{master: '{}', host: {}}}", config.master_uri, config.host)
}

async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(TIMEOUT, future).await.unwrap_or_else(|_| panic!("not in {TIMEOUT:?}: {what}"))
}

async fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    within(what, async {
        while !is_so() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await
}

/// What a `std_msgs/msg/String` says; DDS pads it.
fn text(cdr: &[u8]) -> &str {
    let length = u32::from_le_bytes(cdr[4..8].try_into().unwrap()) as usize;
    std::str::from_utf8(&cdr[8..7 + length]).unwrap()
}

/// A `std_msgs/msg/String`.
fn cdr(text: &str) -> RawSample {
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend((text.len() as u32 + 1).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.push(0);
    RawSample::parse(Bytes::from(bytes)).unwrap()
}

/// How long anything may take on a busy machine.
const TIMEOUT: Duration = Duration::from_secs(60);
