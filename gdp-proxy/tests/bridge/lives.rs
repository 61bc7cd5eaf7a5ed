//! Publishers that come and go: whoever is there hears what they say, and nobody takes one for
//! there that has gone.

use gdp_tests::dds_domain::lease;
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp::unstable::Subscription;
use gdp_e2e::seal::Message;
use gdp_proxy::ros2::{Domain, RawReader, RawWriter, TopicName, TypeName};
use gdp_ros::roster::{Dialect, Kind, Offer, Outgoing, ROSTER};

use crate::master::Master;
use crate::peer::{Peer, Vendor};
use crate::site::{Proxy, Site};
use crate::{LATCHED, RELIABLE, cdr, graph, text, texts, until, within};

#[tokio::test(flavor = "multi_thread")]
async fn a_publisher_of_a_single_message_is_heard() {
    let site = Site::start().await;
    let (here, there) = (Master::start().await, Master::start().await);
    let (near, far) = (lease(), lease());
    let topics = [site.topic("/ros1", "std_msgs/msg/String")];
    let others = [site.topic("/ros2", "std_msgs/msg/String")];
    let _proxies = [
        site.proxy("a", &graph(&here), &topics, "direction: out"),
        site.proxy("b", &graph(&there), &topics, "direction: in"),
        site.proxy("c", &domain(near), &others, "direction: out"),
        site.proxy("d", &domain(far), &others, "direction: in"),
    ];
    let (mut listener, _) = there.peer("listener", &["listen", "/ros1"]).await;
    let _once = here.begin("once", &["once", "/ros1", "only this"]);
    assert_eq!(texts(&mut listener, 1).await, ["only this"]);

    let (talking, listening) = (Domain::join(near, "talker").unwrap(), Domain::join(far, "listener").unwrap());
    let reader = listening.reader(&topic("/ros2"), &string(), &RELIABLE).unwrap();
    // A first one, of whom all is learned, and one that comes when all is known.
    for said in ["the first", "the second"] {
        let mut writer = talking.writer(&topic("/ros2"), &string(), &RELIABLE).unwrap();
        matched(&writer).await;
        writer.write(cdr(said), 0).await.unwrap();
        within("the proxy has it", writer.settle()).await;
        // ROS stays for 100 ms; on a machine that is busy that may be too short for anybody to see
        // it.
        tokio::time::sleep(Duration::from_millis(500)).await;
        drop(writer);
        assert_eq!(text(&received(&reader).await), said);
    }
    talking.leave().await;
    listening.leave().await;
}

/// `rosnode list` shows no node for each topic.
#[tokio::test(flavor = "multi_thread")]
async fn the_proxy_has_as_many_nodes_as_a_topic_has_latching_publishers() {
    let site = Site::start().await;
    let (here, there) = (Master::start().await, Master::start().await);
    let single = ["/a", "/b", "/c", "/d"].map(|topic| site.topic(topic, "std_msgs/msg/String"));
    let several = ["/e", "/f"].map(|topic| site.topic(topic, "std_msgs/msg/String"));
    let topics: Vec<_> = single.into_iter().chain(several).collect();
    let _out = site.proxy("robot", &graph(&here), &topics, "direction: out");
    let _in = site.proxy("cloud", &graph(&there), &topics, "direction: in");
    let mut publishers = Vec::new();
    for topic in ["/a", "/b", "/c", "/d", "/e", "/f"] {
        publishers.push(here.begin(&format!("first{}", &topic[1..]), &["latch", topic, "one"]));
    }
    for topic in ["/a", "/b", "/c", "/d", "/e", "/f"] {
        let mut listener = there.begin(&format!("early{}", &topic[1..]), &["listen", topic]);
        assert_eq!(texts(&mut listener, 1).await, ["one"]);
    }
    let of_proxies = async |name: &str| {
        let shown = there.begin(name, &["nodes"]).event("nodes").await;
        let names = shown["names"].as_array().unwrap().iter().map(|name| name.as_str().unwrap());
        names.filter(|name| name.starts_with("/gdp_proxy_")).count()
    };
    assert_eq!(of_proxies("before").await, 1);
    for topic in ["/e", "/f"] {
        for text in ["two", "three"] {
            publishers.push(here.begin(&format!("{text}{}", &topic[1..]), &["latch", topic, text]));
        }
        let mut listener = there.begin(&format!("late{}", &topic[1..]), &["listen", topic]);
        assert_eq!(texts(&mut listener, 3).await, ["one", "three", "two"]);
    }
    // For both topics together: three, and not five. A node that was needed for a moment leaves
    // again. A publisher is known to latch only once it is connected, so its writer may be made
    // twice. Then the topics may be at different nodes, which are four.
    let mut shown = Vec::new();
    while shown.last().is_none_or(|nodes| *nodes > 4) {
        assert!(shown.len() < 20, "{shown:?}");
        shown.push(of_proxies(&format!("after{}", shown.len())).await);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_publisher_beside_one_that_latches_does_not_latch_and_the_last_of_a_burst_is_not_lost() {
    let site = Site::start().await;
    let id = lease();
    let topics = [site.topic("/mixed", "std_msgs/msg/String")];
    let _proxy = site.proxy("robot", &domain(id), &topics, "direction: out, max_hz: 2");
    let talking = Domain::join(id, "talker").unwrap();
    let mut early = site.subscribe(&topics[0]).await;
    let mut writers = [LATCHED, RELIABLE].map(|offers| talking.writer(&topic("/mixed"), &string(), &offers).unwrap());
    for (writer, texts) in writers.iter_mut().zip([["a 1", "a 2", "a 3"], ["b 1", "b 2", "b 3"]]) {
        matched(writer).await;
        for text in texts {
            writer.write(cdr(text), 0).await.unwrap();
        }
    }
    let (mut heard, last) = (Vec::new(), ["a 3", "b 3"].map(|text| cdr(text).bytes));
    while !last.iter().all(|last| heard.contains(last)) {
        heard.push(message(&mut early).await.body);
    }
    assert!(heard.len() < 6, "two a second: {heard:?}");

    let mut late = site.subscribe(&topics[0]).await;
    assert_eq!(message(&mut late).await.body, last[0]);
    let more = tokio::time::timeout(Duration::from_millis(1500), message(&mut late)).await;
    assert!(more.is_err(), "{more:?}");
    talking.leave().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_publisher_that_is_not_heard_of_is_missed_and_comes_back_with_what_it_latches() {
    let (site, there) = (Site::start().await, Master::start().await);
    let near = lease();
    let topics = [site.topic("/map", "std_msgs/msg/String")];
    let out = site.proxy("robot", &domain(near), &topics, "direction: out");
    let _in = site.proxy("cloud", &graph(&there), &topics, "direction: in");
    let talking = Domain::join(near, "talker").unwrap();
    let lively = Offer { liveliness_ns: 1_000_000_000, ..LATCHED };
    let mut writer = talking.writer(&topic("/map"), &string(), &lively).unwrap();
    writer.write(cdr("the map"), 0).await.unwrap();
    let mut early = there.begin("early", &["listen", "/map"]);
    assert_eq!(texts(&mut early, 1).await, ["the map"]);

    // Its proxy is not heard of for longer than it promised to show that it lives.
    let graph_observer = there.node("/graph_observer").await;
    let mut shown = graph_observer.graph();
    publishers(&mut shown, "/map", 1).await;
    out.signal(libc::SIGSTOP);
    publishers(&mut shown, "/map", 0).await;
    out.signal(libc::SIGCONT);
    let mut late = there.begin("late", &["listen", "/map"]);
    assert_eq!(texts(&mut late, 1).await, ["the map"], "nobody has written it again");
    writer.write(cdr("another map"), 0).await.unwrap();
    // On a machine that is busy it may be missed once more, and then says again what it latches.
    while texts(&mut late, 1).await != ["another map"] {}
    graph_observer.leave().await;
    talking.leave().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_status_says_which_publisher_has_no_counterpart_until_it_has_gone() {
    let site = Site::start().await;
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let id = lease();
    let proxy = site.proxy("cloud", &domain(id), &topics, "direction: in");
    status(&proxy, "up").await;
    let publisher = site.publish(&topics[0]).await;
    let int32 = Kind { dialect: Dialect::Ros2, name: "std_msgs/msg/Int32".into(), hash: vec![] };
    let mut roster = Outgoing::new(int32.clone(), None);
    roster.joined('a', "", RELIABLE);
    roster.announce(Instant::now(), &publisher).unwrap();
    status(&proxy, "publishes std_msgs/msg/Int32, and the topic is of std_msgs/msg/String").await;
    publisher.pin(ROSTER, &roster.farewell().unwrap());
    status(&proxy, "up").await;

    let mut roster = Outgoing::new(Kind { name: "std_msgs/msg/String".into(), ..int32 }, None);
    roster.joined('a', "", Offer { reliable: false, ..RELIABLE });
    roster.announce(Instant::now(), &publisher).unwrap();
    let listening = Domain::join(id, "listener").unwrap();
    let reader = listening.reader(&topic("/chatter"), &string(), &RELIABLE).unwrap();
    status(&proxy, "incompatible QoS: a subscriber here asks for more in reliability than publisher 0 of").await;
    drop(reader);
    status(&proxy, "up").await;
    listening.leave().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_status_says_that_a_topic_has_keys() {
    let site = Site::start().await;
    let id = lease();
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let proxy = site.proxy("robot", &domain(id), &topics, "direction: out");
    let keyed = Peer::topic(Vendor::Cyclone, "talk", id, &["--keyed", "--no-wait"]);
    status(&proxy, "its type has key fields (`@key`), and topics with keys are not carried").await;
    keyed.kill().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_status_says_which_publisher_is_not_heard_and_why() {
    let site = Site::start().await;
    let id = lease();
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let proxy = site.proxy("robot", &domain(id), &topics, "direction: out, qos: {reliability: reliable}");
    let talking = Domain::join(id, "talker").unwrap();
    let unreliable = Offer { reliable: false, ..RELIABLE };
    let writer = talking.writer(&topic("/chatter"), &string(), &unreliable).unwrap();
    status(&proxy, "incompatible QoS: `qos` asks for more than it offers in reliability").await;
    drop(writer);
    status(&proxy, "up").await;
    talking.leave().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_proxy_that_ends_leaves_nothing_at_the_master() {
    let site = Site::start().await;
    let (here, there) = (Master::start().await, Master::start().await);
    let topics = [site.topic("/latched", "std_msgs/msg/String")];
    let out = site.proxy("robot", &graph(&here), &topics, "direction: out");
    let into = site.proxy("cloud", &graph(&there), &topics, "direction: in");
    let graph_observer = there.node("/graph_observer").await;
    let mut shown = graph_observer.graph();
    let one = here.begin("one", &["latch", "/latched", "one"]);
    let _two = here.begin("two", &["latch", "/latched", "two"]);
    publishers(&mut shown, "/latched", 2).await;
    drop(one);
    publishers(&mut shown, "/latched", 1).await;
    into.stop();
    publishers(&mut shown, "/latched", 0).await;
    drop(out);
    graph_observer.leave().await;
}

/// A topic without a publisher is in the log once, and in the diagnostics until there is one.
#[tokio::test(flavor = "multi_thread")]
async fn what_a_topic_waits_for_is_said_once_and_ends_with_a_publisher() {
    let site = Site::start().await;
    let id = lease();
    let kind = TypeName::parse("std_msgs/msg/String").unwrap();
    let others = Domain::join(id, "others").unwrap();
    let _other = others.writer(&topic("/other"), &kind, &RELIABLE).unwrap();
    let _subscriber = others.reader(&topic("/read"), &kind, &RELIABLE).unwrap();
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let proxy = site.proxy_of("a", &domain(id), &topics, "direction: out", "diagnostics: true");
    let waits_for = |value: &str| proxy.topics().first().is_some_and(|topic| topic["waiting_for"] == value);
    until("the statistics", || waits_for("local_publisher")).await;
    let line = format!("waiting for a local publisher of topic /chatter in domain {id}");
    let logged = || {
        let log = std::fs::read_to_string(site.folder("a").join("log")).unwrap();
        log.lines().filter(|text| text.contains(&line)).map(str::to_owned).collect::<Vec<_>>()
    };
    until("the log", || !logged().is_empty()).await;
    assert!(logged()[0].contains("seen there: /other") && !logged()[0].contains("/read"), "{:?}", logged());

    let listening = Domain::join(id, "listener").unwrap();
    let diagnostics = TypeName::parse("diagnostic_msgs/msg/DiagnosticArray").unwrap();
    let reader = listening.reader(&topic("/diagnostics"), &diagnostics, &RELIABLE).unwrap();
    let says = |bytes: &[u8], text: &str| bytes.windows(text.len()).any(|part| part == text.as_bytes());
    while !says(&received(&reader).await, "a local publisher") {}

    let talker = others.writer(&topic("/chatter"), &kind, &RELIABLE).unwrap();
    while !says(&received(&reader).await, "a reader") {}
    assert!(!says(&received(&reader).await, "a local publisher"));
    until("the statistics", || waits_for("reader")).await;
    let subscription = site.subscribe(&topics[0]).await;
    until("the statistics", || proxy.topics()[0]["waiting_for"].is_null()).await;
    drop((talker, subscription));
    until("the statistics", || waits_for("local_publisher")).await;
    tokio::time::sleep(std::time::Duration::from_secs(7)).await;
    assert_eq!(logged().len(), 1, "once: {:?}", logged());
    listening.leave().await;
    others.leave().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn diagnostics_say_how_a_topic_does_in_either_version() {
    let (site, master) = (Site::start().await, Master::start().await);
    let id = lease();
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let _proxies = [("a", domain(id)), ("b", graph(&master))]
        .map(|(label, graph)| site.proxy_of(label, &graph, &topics, "direction: out", "diagnostics: true"));
    let says = |bytes: &[u8], text: &str| bytes.windows(text.len()).any(|part| part == text.as_bytes());
    let is_told = |bytes: &[u8]| says(bytes, "gdp_proxy: /chatter out") && says(bytes, "waiting for a local publisher");

    let listening = Domain::join(id, "listener").unwrap();
    let kind = TypeName::parse("diagnostic_msgs/msg/DiagnosticArray").unwrap();
    let reader = listening.reader(&topic("/diagnostics"), &kind, &RELIABLE).unwrap();
    while !is_told(&received(&reader).await) {}
    listening.leave().await;

    let graph_observer = master.node("/graph_observer").await;
    let mut subscription = graph_observer.subscribe("/diagnostics", gdp_ros1::SubscribeOptions::default()).unwrap();
    let mut next = async || within("diagnostics", subscription.next()).await.unwrap();
    let mut message = next().await;
    while !is_told(&message.data) {
        message = next().await;
    }
    assert_eq!(message.publisher.kind, "diagnostic_msgs/DiagnosticArray");
    graph_observer.leave().await;
}

/// The next that is no roster.
async fn message(subscription: &mut Subscription) -> Message {
    within("a message", async {
        loop {
            let message = subscription.recv().await.unwrap();
            if message.encoding != ROSTER {
                return message;
            }
        }
    })
    .await
}

/// Waits until the master knows so many publishers of a topic.
async fn publishers(shown: &mut gdp_ros1::Graph, topic: &str, count: usize) {
    within(&format!("{count} publishers of {topic}"), async {
        let publishers =
            |shown: &gdp_ros1::Graph| shown.snapshot().topics.get(topic).map_or(0, |topic| topic.publishers.len());
        while publishers(shown) != count {
            shown.changes().await.unwrap();
        }
    })
    .await;
}

/// Waits for the status of its only route.
pub async fn status(proxy: &Proxy, expected: &str) {
    let is_so = |status: &str| if expected == "up" { status == expected } else { status.contains(expected) };
    until(expected, || proxy.statuses().first().is_some_and(|status| is_so(status))).await;
}

async fn matched(writer: &RawWriter) {
    until("a reader", || writer.has_matched()).await;
}

pub async fn received(reader: &RawReader) -> Bytes {
    within("a message", reader.recv()).await.unwrap().sample.bytes
}

pub fn domain(id: u16) -> String {
    format!("{{domain_id: {id}}}")
}

pub fn topic(name: &str) -> TopicName {
    TopicName::parse(name).unwrap()
}

pub fn string() -> TypeName {
    TypeName::parse("std_msgs/msg/String").unwrap()
}
