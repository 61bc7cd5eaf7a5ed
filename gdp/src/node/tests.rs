//! Nodes against a switch and RIB of a page, over UDP on loopback. No root. The real ones: `gdp-ctl`, `tests/`.

mod fabric;

use std::time::Duration;

use self::fabric::{Fabric, Owner, eventually};
use super::*;
use crate::control::RefusalCode;
use crate::seal::Encoding;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_arrive_by_name() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();
    for body in [vec![], b"hello".to_vec(), vec![7; 1_000], vec![8; 100_000], vec![9; 1_000_000]] {
        publisher.send(Encoding::Cdr, &body).await.unwrap();
        let received = tokio::time::timeout(Duration::from_secs(5), subscription.recv()).await;
        let message = received.unwrap_or_else(|_| panic!("{:?} {:?}", robot.counters(), cloud.counters())).unwrap();
        assert_eq!((&message.body[..], message.encoding, message.writer), (&body[..], Encoding::Cdr, robot.name()));
    }
    let (sent, received) = (robot.counters(), cloud.counters());
    assert_eq!((sent.messages_sent, sent.links, sent.messages_unsent), (5, 1, 0));
    assert_eq!(received.messages_received, 5);
    assert_eq!(received.frames_received, sent.frames_sent);
    assert!(received.drops.is_empty(), "{received:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_writers_with_the_owners_certificate_are_believed() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud, rogue) = (fabric.node("proxy").await, fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();

    // The rogue has the epoch key, and a RIB that lies for it: a certificate that another key signed.
    let card = owner.card();
    let forged = Owner::of_card(card.clone()).ad_cert(rogue.name());
    assert!(matches!(
        rogue.publish(card.proof(), forged.clone(), owner.key()).await,
        Err(NodeError::Cert(CertError::WrongKey { .. }))
    ));
    fabric.lie(card.name(), &rogue, card.proof(), forged);
    let key = rogue.0.state.identity.key().clone();
    let mut writer = Writer::new(card.name(), rogue.name(), key, Backend::default()).unwrap();
    writer.set_epoch(EPOCH, owner.key()).unwrap();
    let mut forger = Publisher::new(rogue.0.clone(), card.name(), writer, Arc::default());
    forger.send(Encoding::Bytes, b"forged").await.unwrap();
    eventually("the forger's frame is dropped", || cloud.counters().drops.contains_key("seal_unknown_writer")).await;

    publisher.send(Encoding::Bytes, b"true").await.unwrap();
    assert_eq!(&recv(&mut subscription).await.body[..], b"true");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_writer_that_comes_later_is_learnt() {
    let fabric = Fabric::start().await;
    fabric.push_writers(false);
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();
    // Nobody told the subscriber: the first frame makes it ask, and waits for the answer.
    publisher.send(Encoding::Bytes, &[1; 10_000]).await.unwrap();
    publisher.send(Encoding::Bytes, &[2; 10]).await.unwrap();
    for body in [vec![1; 10_000], vec![2; 10]] {
        let message = recv(&mut subscription).await;
        assert_eq!((&message.body[..], message.writer), (&body[..], robot.name()));
    }
    assert!(cloud.counters().drops.is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn everything_is_stated_again_after_the_link_was_lost() {
    let mut fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let mut publisher = owner.publish(&robot).await.unwrap();
    publisher.send(Encoding::Bytes, b"before").await.unwrap();
    recv(&mut subscription).await;

    fabric.stop().await;
    eventually("the robot notices", || robot.switch().is_err()).await;
    let error = publisher.send(Encoding::Bytes, b"lost").await.unwrap_err();
    assert!(matches!(&error, NodeError::Detached(_)), "{error}");
    fabric.restart().await;
    eventually("both are back", || robot.counters().links == 2 && cloud.counters().links == 2).await;
    eventually("all is stated", || fabric.writers(owner.name()) == 1 && fabric.has_subscriber(owner.name())).await;
    // The RIB forgot the serials with all else; the nodes did not.
    assert!(fabric.serial(robot.name()) > 1);
    publisher.send(Encoding::Bytes, b"after").await.unwrap();
    assert_eq!(&recv(&mut subscription).await.body[..], b"after");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn dropped_handles_withdraw_and_a_closed_node_detaches() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    let publisher = owner.publish(&robot).await.unwrap();
    assert!(matches!(owner.publish(&robot).await, Err(NodeError::Already { stated: Stated::Published, .. })));
    drop(publisher);
    eventually("withdrawn", || fabric.writers(owner.name()) == 0).await;
    let mut publisher = owner.publish(&robot).await.unwrap();
    assert_eq!(fabric.writers(owner.name()), 1);

    cloud.close().await;
    assert!(subscription.recv().await.is_none());
    robot.close().await;
    eventually("both detached", || fabric.links() == 0).await;
    assert!(matches!(publisher.send(Encoding::Bytes, b"x").await, Err(NodeError::Closed)));
    assert!(matches!(owner.publish(&robot).await, Err(NodeError::Already { .. } | NodeError::Closed)));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_withdrawal_gets_through_in_the_end_and_takes_nothing_else_along() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let node = fabric.node("proxy").await;
    let _subscription = owner.subscribe(&node).await.unwrap();
    let publisher = owner.publish(&node).await.unwrap();
    fabric.refuse(Some(RefusalCode::Unreachable));
    let serial = fabric.serial(node.name());
    drop(publisher);
    eventually("the withdrawal was refused", || fabric.serial(node.name()) > serial).await;
    assert_eq!(fabric.writers(owner.name()), 1);
    fabric.refuse(None);
    eventually("withdrawn", || fabric.writers(owner.name()) == 0).await;
    eventually("subscribed again", || fabric.has_subscriber(owner.name())).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_is_dropped_lets_go_of_its_link() {
    let fabric = Fabric::start().await;
    let node = fabric.node("proxy").await;
    let publisher = Owner::new("/chatter").publish(&node).await.unwrap();
    drop(node);
    assert_eq!(fabric.links(), 1, "the publisher still needs it");
    drop(publisher);
    eventually("detached", || fabric.links() == 0).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_serial_that_somebody_else_used_is_learnt() {
    let fabric = Fabric::start().await;
    let node = fabric.node("proxy").await;
    fabric.set_serial(node.name(), 1000);
    let owner = Owner::new("/chatter");
    let publisher = owner.publish(&node).await.unwrap();
    assert_eq!(fabric.serial(node.name()), 1001);
    fabric.set_serial(node.name(), 2000);
    drop(publisher);
    eventually("withdrawn", || fabric.writers(owner.name()) == 0).await;
    assert_eq!(fabric.serial(node.name()), 2001);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn refusals_and_wrong_papers_are_told() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (node, other) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let of_other = owner.ad_cert(other.name());
    let error = node.publish(owner.card().proof(), of_other, owner.key()).await.err().unwrap();
    assert!(matches!(error, NodeError::Cert(CertError::WrongEntity { .. })), "{error}");

    fabric.refuse(Some(RefusalCode::Limit));
    let error = owner.publish(&node).await.err().unwrap();
    assert!(matches!(&error, NodeError::Refused(refusal) if refusal.code == RefusalCode::Limit), "{error}");
    fabric.refuse(None);
    let _publisher = owner.publish(&node).await.expect("nothing is left of the refused one");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn connecting_fails_with_the_reason() {
    let fabric = Fabric::start().await;
    let identity = Identity::generate("proxy").unwrap();
    let mut config = NodeConfig::new(identity.clone(), fabric.target());
    config.switch = Some(identity.name());
    assert!(matches!(Node::connect(config).await, Err(NodeError::Link(LinkError::WrongPeer { .. }))));

    let nobody = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let target = format!("udp://{}", nobody.local_addr().unwrap()).parse().unwrap();
    let mut config = NodeConfig::new(identity.clone(), target);
    config.connect_timeout = Duration::from_millis(300);
    assert!(matches!(Node::connect(config).await, Err(NodeError::Detached(_))));

    let config = NodeConfig::new(identity, "eth://gdpnone0".parse().unwrap());
    let error = Node::connect(config).await.err().unwrap().to_string();
    assert!(error.contains("gdpnone0"), "{error}");
}

async fn recv(subscription: &mut Subscription) -> crate::seal::Message {
    tokio::time::timeout(Duration::from_secs(5), subscription.recv()).await.expect("a message in time").unwrap()
}
