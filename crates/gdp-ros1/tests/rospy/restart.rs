//! What the master knows of a node, and what happens when it forgets.

use std::collections::BTreeSet;
use std::time::Duration;

use bytes::Bytes;
use gdp_ros1::{
    Change, MasterState, PublishOptions, QueueLimits, ServiceType, Snapshot, SourceState, SubscribeOptions,
};
use tokio::time::timeout;

use crate::harness::{LIMIT, Master, next_text, registered, string, string_type, until};

const LATCHED: PublishOptions = PublishOptions { latch: true, queue: QueueLimits { messages: 10, bytes: 1 << 20 } };

fn trigger() -> ServiceType {
    ServiceType { name: "std_srvs/Trigger".to_owned(), md5sum: "937c9679a518e3a18d831e57125ea522".to_owned() }
}

#[tokio::test]
async fn a_master_that_starts_anew_stops_nothing_and_learns_everything_again() {
    let mut master = Master::start().await;
    let node = master.node("/bridge").await;
    let publisher = node.publish("/out", string_type(), LATCHED).unwrap();
    let mut subscription = node.subscribe("/in", SubscribeOptions::default()).unwrap();
    let _server = node.serve("/service", trigger(), 1, async |_| Ok(Bytes::new())).unwrap();
    let (mut talker, _) = master.peer("talker", &["publish", "/in", "talker"]).await;
    let (mut listener, _) = master.peer("listener", &["listen", "/out"]).await;
    next_text(&mut subscription).await;
    until("rospy connects", async || (!publisher.subscribers().is_empty()).then_some(())).await;

    master.kill();
    let mut status = node.status();
    let missed = status.wait_for(|status| matches!(status.master, MasterState::Unreachable(_)));
    let missed = timeout(LIMIT, missed).await.unwrap().unwrap().clone();
    let MasterState::Unreachable(reason) = missed.master else { unreachable!() };
    assert!(reason.contains("is roscore running"), "{reason}");
    // What is connected goes on without it.
    publisher.publish(string("without a master")).unwrap();
    assert_eq!(listener.event("message").await["data"], "without a master");
    next_text(&mut subscription).await;

    master.restart().await;
    // Whoever comes now finds us, though rospy's nodes from before do not register again.
    let (mut late, _) = master.peer("late", &["listen", "/out"]).await;
    assert_eq!(late.event("message").await["data"], "without a master");
    let (_second, _) = master.peer("second", &["publish", "/in", "second"]).await;
    let mut heard = BTreeSet::new();
    while heard.len() < 2 {
        heard.insert(next_text(&mut subscription).await.1);
    }
    assert_eq!(heard, ["/second", "/talker"].map(str::to_owned).into());
    registered(&node).await;
    let client = master.node("/caller").await.client("/service").unwrap();
    assert_eq!(client.probe(LIMIT).await.unwrap().kind, "std_srvs/Trigger");
    publisher.publish(string("all of you")).unwrap();
    // Who connected anew may hear the last one again first.
    for listener in [&mut listener, &mut late] {
        while listener.event("message").await["data"] != "all of you" {}
    }
    let sources = subscription.sources();
    let connected = sources.borrow().values().filter(|state| matches!(state, SourceState::Connected(_))).count();
    assert_eq!(connected, 2, "{:?}", sources.borrow());

    // The graph shows both, and who has gone no more.
    let (mut graph, mut seen) = (node.graph(), Snapshot::default());
    let nodes = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
    for there in [nodes(&["/second", "/talker"]), nodes(&["/second"])] {
        watch(&mut graph, &mut seen, |seen| {
            let shown = seen.topics.get("/in");
            shown.is_some_and(|topic| topic.publishers == there && topic.kind.as_deref() == Some("std_msgs/String"))
        })
        .await;
        if there.contains("/talker") {
            talker.stop().await;
        }
    }
}

#[tokio::test]
async fn the_graph_shows_what_comes_and_goes_and_nothing_of_us_once_we_left() {
    let master = Master::start().await;
    let (node, watcher) = (master.node("/bridge").await, master.node("/watcher").await);
    let mut graph = watcher.graph();
    let mut seen = Snapshot::default();
    let publisher = node.publish("/out", string_type(), LATCHED).unwrap();
    let _subscription = node.subscribe("/in", SubscribeOptions::default()).unwrap();
    let _server = node.serve("/service", trigger(), 1, async |_| Ok(Bytes::new())).unwrap();
    let (mut talker, _) = master.peer("talker", &["publish", "/in", "talker"]).await;
    let bridge = BTreeSet::from(["/bridge".to_owned()]);
    let changed = watch(&mut graph, &mut seen, |seen| {
        seen.topics.get("/in").is_some_and(|topic| topic.kind.is_some() && topic.publishers.contains("/talker"))
            && seen.services.contains_key("/service")
            && seen.topics.contains_key("/out")
    });
    changed.await;
    assert_eq!(seen.topics["/in"].kind.as_deref(), Some("std_msgs/String"));
    assert_eq!((&seen.topics["/in"].subscribers, &seen.topics["/out"].publishers), (&bridge, &bridge));
    assert_eq!(seen.services["/service"], bridge);

    talker.stop().await;
    drop(publisher);
    watch(&mut graph, &mut seen, |seen| {
        !seen.topics.contains_key("/out") && seen.topics.get("/in").is_some_and(|topic| topic.publishers.is_empty())
    })
    .await;
    // With handles still there.
    node.leave().await;
    watch(&mut graph, &mut seen, |seen| {
        seen.topics
            .values()
            .all(|topic| topic.publishers.is_disjoint(&bridge) && topic.subscribers.is_disjoint(&bridge))
            && !seen.services.contains_key("/service")
    })
    .await;
}

#[tokio::test]
async fn two_masters_and_a_name_that_another_node_takes() {
    let (first, second) = (Master::start().await, Master::start().await);
    let (here, there) = (first.node("/bridge").await, second.node("/bridge").await);
    let mut heard = here.subscribe("/chatter", SubscribeOptions::default()).unwrap();
    let publisher = there.publish("/chatter", string_type(), LATCHED).unwrap();
    publisher.publish(string("from there")).unwrap();
    registered(&here).await;
    registered(&there).await;
    // Of the same name, at another master: nothing to do with each other.
    let other = first.node("/other").await;
    let elsewhere = other.publish("/chatter", string_type(), LATCHED).unwrap();
    elsewhere.publish(string("from here")).unwrap();
    assert_eq!(next_text(&mut heard).await, ("from here".to_owned(), "/other".to_owned()));

    // The newcomer has the name, as ROS has it; the one from before says so, and does not fight for
    // it.
    let newcomer = first.node("/bridge").await;
    let _taken = newcomer.subscribe("/another", SubscribeOptions::default()).unwrap();
    let mut status = here.status();
    let taken = MasterState::NameTaken(newcomer.uri().to_owned());
    let told = status.wait_for(|status| status.master == taken && status.shutdown.is_some());
    drop(timeout(LIMIT, told).await.expect("told in time").unwrap());
    // When it leaves, the name and all that was registered come back.
    newcomer.leave().await;
    registered(&here).await;
    let mut graph = other.graph();
    watch(&mut graph, &mut Snapshot::default(), |seen| {
        seen.topics.get("/chatter").is_some_and(|topic| topic.subscribers.contains("/bridge"))
    })
    .await;
}

#[tokio::test]
async fn a_node_begins_before_its_master() {
    let mut master = Master::start().await;
    master.kill();
    let node = master.node("/bridge").await;
    let publisher = node.publish("/out", string_type(), LATCHED).unwrap();
    publisher.publish(string("early")).unwrap();
    master.restart().await;
    let (mut listener, _) = master.peer("listener", &["listen", "/out"]).await;
    assert_eq!(listener.event("message").await["data"], "early");
    // Leaving without a master takes no longer than it must.
    master.kill();
    timeout(Duration::from_secs(10), node.leave()).await.expect("left");
}

/// Applies changes to what was seen until it is as wanted. So the changes must be all there are.
async fn watch(graph: &mut gdp_ros1::Graph, seen: &mut Snapshot, wanted: impl Fn(&Snapshot) -> bool) {
    let watched = async {
        while !wanted(seen) {
            for change in graph.changes().await.expect("the node is there") {
                match change {
                    Change::Topic { name, topic } => _ = seen.topics.insert(name, topic),
                    Change::TopicRemoved { name } => assert!(seen.topics.remove(&name).is_some()),
                    Change::Service { name, nodes } => _ = seen.services.insert(name, nodes),
                    Change::ServiceRemoved { name } => assert!(seen.services.remove(&name).is_some()),
                }
            }
            assert_eq!(seen, graph.snapshot());
        }
    };
    let in_time = timeout(LIMIT, watched).await.is_ok();
    assert!(in_time, "the graph stays {seen:?}");
}
