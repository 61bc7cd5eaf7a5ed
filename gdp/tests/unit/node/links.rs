//! Tests of nodes with several links.

use std::sync::atomic::AtomicU64;
use std::time::Instant;

use tokio::time::MissedTickBehavior;

use super::*;
use gdp_link::link::REQUEST_TIMEOUT;
use gdp_link::tunnel::{TlsListener, TunnelPeers};

/// Interval between two messages in the tests.
const PERIOD: Duration = Duration::from_millis(10);

/// Number of segments of a small message, which includes its proof.
const SEGMENTS: u64 = 1;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_goes_by_two_links_is_not_missed_when_one_is_cut_and_comes_once() {
    let fabric = Fabric::start().await;
    let robot = fabric.node_by("proxy", [None, None]).await;
    let cloud = fabric.node("proxy").await;
    // A lifetime that suffices on a busy machine.
    let (reliability, history) = (Reliability::BestEffort { lifetime: TIMEOUT }, 1024);
    let best_effort = PublishOptions { reliability, history, ..PublishOptions::best_effort() };
    for options in [PublishOptions::reliable(), best_effort] {
        let (owner, reliable) = (Owner::new("/cmd_vel"), matches!(options.reliability, Reliability::Reliable { .. }));
        let mut subscription = match reliable {
            true => owner.subscribe(&cloud).await.unwrap(),
            false => owner.subscribe_as(&cloud, SubscribeOptions::best_effort()).await.unwrap(),
        };
        let mut publisher = owner.publish_as(&robot, PublishOptions { duplicate: true, ..options }).await.unwrap();
        publisher.send(Encoding::Bytes, &[0]).await.unwrap();
        assert_eq!(recv(&mut subscription).await.sequence, 1);
        let before = robot.links();

        let sending = tokio::spawn(async move {
            let mut ticks = tokio::time::interval(PERIOD);
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
            for i in 2..=200u64 {
                ticks.tick().await;
                assert_eq!(publisher.send(Encoding::Bytes, &[1; 3000]).await.unwrap(), i);
            }
            publisher
        });
        for i in 2..=200 {
            if i == 50 {
                fabric.cut(&robot, 0, true);
            }
            assert_eq!(recv(&mut subscription).await.sequence, i, "none is missing, none comes twice");
        }
        let publisher = sending.await.unwrap();
        let repeated = publisher.counters().topic.repeated;
        assert!(repeated <= A_FEW, "there was no need to: {repeated}");
        eventually("the link that was cut is known to be", || {
            let links = robot.links();
            !links[0].main && links[0].state == LinkState::Silent && links[1].main && links[1].state == LinkState::Up
        })
        .await;
        let links = robot.links();
        assert!(links[1].copies_sent > before[1].copies_sent && links[1].copies_dropped == 0, "{links:?}");
        fabric.cut(&robot, 0, false);
        eventually("the first link is the main one again", || robot.links()[0].main).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn copies_are_dropped_at_the_reader_and_counted() {
    let fabric = Fabric::start().await;
    let (robot, cloud) = (fabric.node_by("proxy", [None, None]).await, fabric.node("proxy").await);
    let owner = Owner::new("/scan");
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let options = PublishOptions { duplicate: true, ..PublishOptions::reliable() };
    let mut publisher = owner.publish_as(&robot, options).await.unwrap();
    let other = Owner::new("/once");
    let mut one_way = other.subscribe(&cloud).await.unwrap();
    let mut once = other.publish(&robot).await.unwrap();
    let arrived = Arc::new(AtomicU64::new(0));
    let (counted, name) = (arrived.clone(), owner.name());
    fabric.set_fate(Some(Box::new(move |header, _| {
        counted.fetch_add(u64::from(header.destination == name), Ordering::Relaxed);
        true
    })));
    for i in 1..=100 {
        once.send(Encoding::Bytes, &[0; 100]).await.unwrap();
        assert_eq!(recv(&mut one_way).await.sequence, i);
        publisher.send(Encoding::Bytes, &[0; 100]).await.unwrap();
        assert_eq!(recv(&mut subscription).await.sequence, i);
    }
    let (sent, frames) = (publisher.counters(), publisher.counters().topic.frames);
    eventually("all copies are there", || arrived.load(Ordering::Relaxed) >= 2 * frames).await;
    let duplicates = || subscription.counters().inbound.duplicates;
    eventually("and are counted", || duplicates() >= SEGMENTS * 100).await;
    assert!(sent.topic.repeated <= A_FEW && duplicates() <= SEGMENTS * 100 + 2 * A_FEW, "{:?}", robot.links());
    assert_eq!(one_way.counters().inbound.duplicates, 0);
    assert!((frames..=frames + A_FEW).contains(&robot.links()[1].copies_sent), "{:?}", robot.links());
    assert_eq!(cloud.counters().messages_received, 200);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_goes_by_one_link_moves_when_that_fails_and_returns() {
    let fabric = Fabric::start().await;
    let (robot, cloud) = (fabric.node_by("proxy", [None, None]).await, fabric.node("proxy").await);
    let (owner, back) = (Owner::new("/scan"), Owner::new("/cmd_vel"));
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();
    let mut commands = back.subscribe(&robot).await.unwrap();
    let mut commander = back.publish(&cloud).await.unwrap();
    for (step, cut) in [false, true, false].into_iter().enumerate() {
        fabric.cut(&robot, 0, cut);
        let first = 50 * step as u64;
        for _ in 0..50 {
            publisher.send(Encoding::Bytes, &[1; 2000]).await.unwrap();
            commander.send(Encoding::Bytes, &[1; 2000]).await.unwrap();
        }
        for i in first + 1..=first + 50 {
            assert_eq!(recv(&mut subscription).await.sequence, i);
            assert_eq!(recv(&mut commands).await.sequence, i);
        }
        eventually("the better link is the main one", || robot.links()[usize::from(cut)].main).await;
    }
    assert_eq!(subscription.counters().inbound.abandoned + commands.counters().inbound.abandoned, 0);
    assert_eq!(robot.counters().links, 2, "no link was lost");
    assert!(robot.links().iter().all(|link| link.copies_sent == 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_may_have_a_name_come_by_each_of_its_links() {
    let fabric = Fabric::start().await;
    let (robot, cloud) = (fabric.node_by("proxy", [None, None]).await, fabric.node("proxy").await);
    let owner = Owner::new("/cmd_vel");
    let options = SubscribeOptions { duplicate: true, ..SubscribeOptions::reliable() };
    let mut commands = owner.subscribe_as(&robot, options).await.unwrap();
    let mut commander = owner.publish(&cloud).await.unwrap();
    let mut ticks = tokio::time::interval(PERIOD);
    for i in 1..=200 {
        if i == 100 {
            eventually("each came twice", || commands.counters().inbound.duplicates >= SEGMENTS * (i - 1)).await;
            fabric.cut(&robot, 0, true);
        }
        commander.send(Encoding::Bytes, &[1; 1000]).await.unwrap();
        assert_eq!(recv(&mut commands).await.sequence, i);
        ticks.tick().await;
    }
    let (repeated, given_up) = (commander.counters().topic.repeated, commands.counters().inbound.abandoned);
    assert!(repeated <= A_FEW && given_up == 0, "{repeated} repeated, {given_up} given up");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_budget_is_that_of_its_link() {
    let fabric = Fabric::start().await;
    let (robot, cloud) = (fabric.node_by("proxy", [None, Some(10_000)]).await, fabric.node("proxy").await);
    let owner = Owner::new("/image");
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let options = PublishOptions { duplicate: true, ..PublishOptions::reliable() };
    let mut publisher = owner.publish_as(&robot, options).await.unwrap();
    let began = Instant::now();
    for i in 1..=3 {
        publisher.send(Encoding::Bytes, &[1; 1_000_000]).await.unwrap();
        assert_eq!(recv(&mut subscription).await.sequence, i);
    }
    let second = &robot.links()[1];
    let most = 10_000 * (began.elapsed().as_secs() + 2);
    // 3 MB are 340 frames or more.
    assert!(second.copies_sent * 1000 < most && second.copies_dropped > 200, "{second:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn copies_that_wait_for_a_link_go_by_it_also_once_it_is_the_main_one() {
    let fabric = Fabric::start().await;
    let (robot, cloud) = (fabric.node_by("proxy", [None, Some(10_000)]).await, fabric.node("proxy").await);
    let owner = Owner::new("/scan");
    let mut subscription = owner.subscribe_as(&cloud, SubscribeOptions::best_effort()).await.unwrap();
    let options = PublishOptions { duplicate: true, ..PublishOptions::best_effort() };
    let mut publisher = owner.publish_as(&robot, options).await.unwrap();
    publisher.send(Encoding::Bytes, &[0; 1000]).await.unwrap();
    recv(&mut subscription).await;
    fabric.cut(&robot, 0, true);
    for _ in 0..60 {
        publisher.send(Encoding::Bytes, &[1; 1000]).await.unwrap();
    }
    eventually("the second link is the main one", || robot.links()[1].main).await;
    let (frames, in_time) =
        (robot.links()[0].frames_sent - robot.counters().feedback_sent, robot.links()[1].copies_sent);
    assert!(in_time < frames, "some still wait: {in_time} of {frames}");
    eventually("all have gone", || robot.links()[1].copies_sent >= frames).await;
    assert_eq!(robot.links()[1].copies_dropped, 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn copies_that_wait_for_a_link_that_is_lost_are_counted() {
    let fabric = Fabric::start().await;
    let (robot, cloud) = (fabric.node_by("proxy", [None, Some(10_000)]).await, fabric.node("proxy").await);
    let owner = Owner::new("/scan");
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let options = PublishOptions { duplicate: true, ..PublishOptions::reliable() };
    let mut publisher = owner.publish_as(&robot, options).await.unwrap();
    publisher.send(Encoding::Bytes, &[1; 100_000]).await.unwrap();
    recv(&mut subscription).await;
    let (copies, frames) = (|| robot.links()[1].copies_dropped, publisher.counters().topic.frames);
    assert_eq!(copies(), 0);
    fabric.end_link(&robot, 1);
    eventually("they are thrown away", || copies() > frames / 2).await;
    let link = &robot.links()[1];
    assert_eq!(link.copies_sent + link.copies_dropped, frames, "{link:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_left_of_the_links_of_a_node_that_is_closed() {
    let fabric = Fabric::start().await;
    let robot = fabric.node_by("proxy", [None, None]).await;
    let links = &robot.0.state.send_path.links;
    let attachments = (0..2).map(|lane| links.connection(lane).attachment().cloned().unwrap());
    let sockets: Vec<_> = attachments.map(|attachment| Arc::downgrade(&attachment.data)).collect();
    robot.close().await;
    let links = robot.links();
    assert!(links.iter().all(|link| link.state == LinkState::Down && link.switch.is_none()), "{links:?}");
    eventually("the sockets are closed", || sockets.iter().all(|socket| socket.strong_count() == 0)).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn frames_are_as_small_as_another_link_takes_only_if_they_may_go_by_it() {
    let fabric = Fabric::start().await;
    let robot = fabric.node_by("proxy", [None, None]).await;
    let (send_path, owner) = (&robot.0.state.send_path, Owner::new("/scan"));
    let mut publisher = Owner::new("/image").publish(&robot).await.unwrap();
    let small = usize::from(SMALLEST_PATH) - Header::LEN;
    eventually("the main link takes large frames", || send_path.links.attached_now().unwrap().max_payload() > small)
        .await;
    // The new link starts with small frames.
    fabric.end_link(&robot, 1);
    eventually("the other is back", || robot.counters().links == 3 && robot.links()[1].state == LinkState::Up).await;
    publisher.send(Encoding::Bytes, &[1; 5000]).await.unwrap();
    assert!(send_path.scheduler.uplink().max_payload() > small);
    let options = PublishOptions { duplicate: true, ..PublishOptions::reliable() };
    let mut doubled = owner.publish_as(&robot, options).await.unwrap();
    doubled.send(Encoding::Bytes, &[1; 5000]).await.unwrap();
    assert_eq!(send_path.scheduler.uplink().max_payload(), small);
    drop(doubled);
    publisher.send(Encoding::Bytes, &[1; 5000]).await.unwrap();
    assert!(send_path.scheduler.uplink().max_payload() > small);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_link_that_has_no_way_to_the_rib_holds_up_no_other() {
    let fabric = Fabric::start().await;
    let robot = fabric.node_by("proxy", [None, None]).await;
    fabric.mute(&robot, 1);
    let mut publishers = Vec::new();
    for _ in 0..4 {
        let began = Instant::now();
        publishers.push(Owner::new("/chatter").publish(&robot).await.unwrap());
        assert!(began.elapsed() < REQUEST_TIMEOUT, "{:?}", began.elapsed());
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_asked_over_a_link_that_falls_silent_is_asked_over_another() {
    let fabric = Fabric::start().await;
    let robot = fabric.node_by("proxy", [None, None]).await;
    fabric.mute(&robot, 0);
    fabric.cut(&robot, 0, true);
    let (owner, began) = (Owner::new("/chatter"), Instant::now());
    let publisher = owner.publish(&robot).await.unwrap();
    assert!(began.elapsed() < REQUEST_TIMEOUT, "{:?}", began.elapsed());
    assert_eq!(fabric.writers(owner.name()), 1);
    drop(publisher);
    eventually("withdrawn", || fabric.writers(owner.name()) == 0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_link_is_enough_to_begin_with_and_there_are_a_few_at_most() {
    let fabric = Fabric::start().await;
    let config = |links: Vec<LinkConfig>, connect_timeout| NodeConfig {
        links,
        connect_timeout,
        ..NodeConfig::new(Identity::generate("proxy").unwrap(), fabric.target())
    };
    let missing: LinkConfig = "eth://gdpnone0".parse::<LinkTarget>().unwrap().into();
    let node = Node::connect(config(vec![missing.clone(), fabric.target().into()], TIMEOUT)).await.unwrap();
    let owner = Owner::new("/chatter");
    let mut subscription = owner.subscribe(&fabric.node("proxy").await).await.unwrap();
    let mut publisher = owner.publish(&node).await.unwrap();
    publisher.send(Encoding::Bytes, b"hello").await.unwrap();
    assert_eq!(&recv(&mut subscription).await.body[..], b"hello");
    eventually("the other is down for a reason", || {
        let link = &node.links()[0];
        link.state == LinkState::Down && link.reason.as_ref().is_some_and(|reason| reason.contains("gdpnone0"))
    })
    .await;
    let nobody = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let nobody: LinkTarget = format!("udp://{}", nobody.local_addr().unwrap()).parse().unwrap();
    let soon = Duration::from_millis(500);
    let error = Node::connect(config(vec![missing.clone(), nobody.into()], soon)).await.err().unwrap();
    assert!(error.may_pass(), "there may be a switch some day: {error}");
    for count in [0, MAX_LANES + 1] {
        let error = Node::connect(config(vec![missing.clone(); count], soon)).await.err().unwrap();
        assert!(matches!(error, NodeError::Links(links) if links == count), "{error}");
    }
    let error = Node::connect(config(vec![missing.clone(); 2], soon)).await.err().unwrap();
    assert!(!error.may_pass());
    let error = error.to_string();
    assert!(error.contains("gdpnone0"), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_link_over_tls_takes_over_where_no_preferred_link_answers() {
    let fabric = Fabric::start().await;
    let LinkTarget::Udp { host, port, .. } = fabric.target() else { panic!("a fabric over UDP") };
    let listener = TlsListener::bind("127.0.0.1:0".parse().unwrap()).await.unwrap();
    let tls: LinkTarget = format!("tls://{}", listener.local_addr().unwrap()).parse().unwrap();
    tokio::spawn(listener.run(format!("{host}:{port}").parse().unwrap(), TunnelPeers::default()));
    let nobody = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let nobody: LinkTarget = format!("udp://{}", nobody.local_addr().unwrap()).parse().unwrap();
    let links = vec![nobody.into(), tls.into()];
    let identity = Identity::generate("proxy").unwrap();
    let node = Node::connect(NodeConfig { links, ..NodeConfig::new(identity, fabric.target()) }).await.unwrap();
    assert!(node.links()[1].main && node.links()[1].state == LinkState::Up, "{:?}", node.links());
    let owner = Owner::new("/chatter");
    let mut subscription = owner.subscribe(&fabric.node("proxy").await).await.unwrap();
    let mut publisher = owner.publish(&node).await.unwrap();
    // More than the MTU of Ethernet, in one frame.
    publisher.send(Encoding::Bytes, &[7; 5000]).await.unwrap();
    assert_eq!(recv(&mut subscription).await.body[..], [7; 5000]);
}
