//! Tests of the QoS that publishers and readers request, and of the outcome of messages when a
//! publisher or reader ends.

use super::*;
use crate::node::Unflushed;
use gdp_e2e::seal::Draft;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_asks_for_more_than_is_offered_gets_the_newest_and_both_are_told() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/scan");
    let (robot, cloud, other) = (fabric.node("proxy").await, fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe_as(&cloud, SubscribeOptions::reliable()).await.unwrap();
    let _compatible = owner.subscribe_as(&other, SubscribeOptions::best_effort()).await.unwrap();
    let mut publisher = owner.publish_as(&robot, PublishOptions::best_effort()).await.unwrap();
    let name = owner.name();
    publisher.send(Encoding::Bytes, b"first").await.unwrap();
    assert_eq!(recv(&mut subscription).await.sequence, 1);
    let vanished = Arc::<AtomicBool>::default();
    let vanishing = vanished.clone();
    fabric.set_fate(Some(Box::new(move |header, _| {
        header.destination != name || vanishing.swap(true, Ordering::Relaxed)
    })));
    publisher.send(Encoding::Bytes, b"lost").await.unwrap();
    eventually("it is lost", || vanished.load(Ordering::Relaxed)).await;
    publisher.send(Encoding::Bytes, b"newest").await.unwrap();
    assert_eq!(&recv(&mut subscription).await.body[..], b"newest", "without a stall");
    let (here, there) = (subscription.counters(), publisher.counters());
    assert_eq!((here.inbound.overtaken, here.incompatible_writers), (1, 1));
    assert_eq!((there.readers, there.incompatible_readers), (2, 1));

    // A writer that offers enough replaces it.
    drop(publisher);
    eventually("withdrawn", || fabric.writers(name) == 0).await;
    let mut publisher = owner.publish(&robot).await.unwrap();
    publisher.send(Encoding::Bytes, b"every").await.unwrap();
    recv(&mut subscription).await;
    assert_eq!((subscription.counters().incompatible_writers, publisher.counters().incompatible_readers), (0, 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_published_before_a_reader_is_welcomed_is_not_lost() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let heard = Arc::<AtomicBool>::default();
    let (hears, writer) = (heard.clone(), robot.name());
    fabric.set_fate(Some(Box::new(move |header, _| header.destination != writer || hears.load(Ordering::Relaxed))));
    let mut publisher = owner.publish(&robot).await.unwrap();
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    assert_eq!(publisher.readers(), 1, "told by the RIB");
    for i in 0..100u32 {
        publisher.send(Encoding::Bytes, &i.to_be_bytes().repeat(1000)).await.unwrap();
    }
    let Err(NodeError::Unflushed(Unflushed { unacknowledged, .. })) = publisher.flush(Duration::ZERO).await else {
        panic!("nothing was acknowledged");
    };
    assert_eq!(unacknowledged.into_iter().collect::<Vec<_>>(), [(cloud.name(), 100)]);
    heard.store(true, Ordering::Relaxed);
    for i in 0..100u32 {
        assert_eq!(recv(&mut subscription).await.body[..4], i.to_be_bytes());
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reliable_publisher_that_is_closed_leaves_nobody_without_its_last_messages() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();
    let mut random = Random::new(9);
    fabric.set_fate(Some(Box::new(move |_, _| random.below(4) > 0)));
    for i in 0..100u32 {
        publisher.send(Encoding::Bytes, &i.to_be_bytes().repeat(500)).await.unwrap();
    }
    publisher.close(TIMEOUT).await.unwrap();
    robot.close().await;
    for i in 0..100u32 {
        assert_eq!(recv(&mut subscription).await.body[..4], i.to_be_bytes());
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_cannot_be_brought_to_its_readers_is_told_in_time() {
    let fabric = Fabric::start().await;
    let (owner, camera) = (Owner::new("/chatter"), Owner::new("/camera"));
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let _other = camera.subscribe_as(&cloud, SubscribeOptions::best_effort()).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();
    let mut best_effort = camera.publish_as(&robot, PublishOptions::best_effort()).await.unwrap();
    publisher.send(Encoding::Bytes, b"one").await.unwrap();
    recv(&mut subscription).await;
    publisher.flush(TIMEOUT).await.unwrap();
    fabric.set_fate(Some(Box::new(|_, _| false)));
    for _ in 0..3 {
        publisher.send(Encoding::Bytes, b"lost").await.unwrap();
        best_effort.send(Encoding::Bytes, &[1; 5000]).await.unwrap();
    }
    best_effort.close(TIMEOUT).await.expect("all has left the host");
    let error = publisher.close(Duration::from_secs(1)).await.unwrap_err();
    let NodeError::Unflushed(Unflushed { unsent, unacknowledged }) = &error else { panic!("{error}") };
    assert_eq!((*unsent, unacknowledged.get(&cloud.name())), (0, Some(&3)), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_of_the_newest_holds_up_nobody_who_closes() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe_as(&cloud, SubscribeOptions::best_effort()).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();
    publisher.send(Encoding::Bytes, b"one").await.unwrap();
    recv(&mut subscription).await;
    fabric.set_fate(Some(Box::new(|_, _| false)));
    publisher.send(Encoding::Bytes, b"lost").await.unwrap();
    publisher.close(Duration::from_secs(1)).await.unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn counters_are_read_from_anywhere_and_outlive_what_they_count() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();
    let (sent, received, node) = (publisher.meter(), subscription.meter(), robot.meter());
    publisher.send(Encoding::Bytes, b"one").await.unwrap();
    recv(&mut subscription).await;
    assert!(robot.0.state.send_path.links.send_one(owner.name(), &[7; 40], false));
    let seen = received.clone();
    let counted = tokio::spawn(async move {
        let dropped = || seen.read().drops.get("seal_truncated").copied();
        eventually("the reader drops what makes no sense", || dropped().is_some()).await;
        dropped()
    });
    assert_eq!(counted.await.unwrap(), Some(1));
    drop((publisher, subscription));
    let as_json = |value: serde_json::Value| (value["messages"].clone(), value["delivered"].clone());
    let shown = (serde_json::to_value(sent.read()).unwrap(), serde_json::to_value(received.read()).unwrap());
    assert_eq!((as_json(shown.0).0, as_json(shown.1).1), (1.into(), 1.into()));
    assert_eq!(node.read().messages_sent, 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn key_boxes_that_are_refused_for_good_are_not_offered_again_and_again() {
    let fabric = Fabric::start().await;
    let (refused, limited) = (Owner::new("/refused"), Owner::new("/limited"));
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    fabric.refuse_boxes(refused.name(), RefusalCode::NotEntitled);
    fabric.refuse_boxes(limited.name(), RefusalCode::Limit);
    let mut publisher = refused.publish(&robot).await.unwrap();
    let mut other = limited.publish(&robot).await.unwrap();
    let mut subscription = refused.subscribe(&cloud).await.unwrap();
    let mut another = limited.subscribe(&cloud).await.unwrap();
    eventually("a limit is asked again", || fabric.refused_boxes(limited.name()) >= 3).await;
    assert_eq!(fabric.refused_boxes(refused.name()), 1);
    fabric.take_boxes();
    other.send(Encoding::Bytes, b"there is room again").await.unwrap();
    assert_eq!(&recv(&mut another).await.body[..], b"there is room again");
    // A new statement may have another outcome.
    publisher.renew(refused.ad_cert_until(robot.name(), 2, unix_seconds() + 60)).await.unwrap();
    publisher.send(Encoding::Bytes, b"by another right").await.unwrap();
    assert_eq!(&recv(&mut subscription).await.body[..], b"by another right");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_late_reader_gets_what_is_pinned_and_the_last_messages_of_each_origin() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/tf_static");
    let (robot, early, late) = (fabric.node("proxy").await, fabric.node("proxy").await, fabric.node("proxy").await);
    let options = PublishOptions { latched: 1, ..PublishOptions::reliable() };
    let mut publisher = owner.publish_as(&robot, options).await.unwrap();
    let mut first = owner.subscribe(&early).await.unwrap();
    publisher.pin(Encoding::Json, b"old");
    publisher.pin(Encoding::Json, b"who");
    for (origin, body) in [([1], b"a"), ([1], b"b"), ([2], b"c"), ([3], b"d")] {
        publisher.send_batch(&[Draft { origin: &origin, ..Draft::new(Encoding::Bytes, body) }]).await.unwrap();
    }
    publisher.forget(&[3]);
    let mut bodies = Vec::new();
    while bodies.last().is_none_or(|body| body != "d") {
        let body = recv(&mut first).await.body;
        // Each new reader causes another transmission of what is pinned then, to all readers.
        if !(bodies.contains(&body) && (body == "old" || body == "who")) {
            bodies.push(body);
        }
    }
    assert_eq!(bodies, ["old", "who", "a", "b", "c", "d"], "each message once");

    let mut second = owner.subscribe(&late).await.unwrap();
    let mut came = Vec::new();
    while came.len() < 3 {
        let message = recv(&mut second).await;
        came.push((message.body, message.latched.is_some(), message.origin.to_vec()));
        came.dedup();
    }
    let expected = [("who".into(), false, vec![]), ("b".into(), true, vec![1]), ("c".into(), true, vec![2])];
    assert_eq!(came, expected);
    publisher.send(Encoding::Bytes, b"next").await.unwrap();
    assert_eq!(&recv(&mut second).await.body[..], b"next");
    let mut known = recv(&mut first).await;
    while known.body == "who" {
        known = recv(&mut first).await;
    }
    assert_eq!(&known.body[..], b"next");
}
