//! Tests of certificates that expire or are revoked while in use, and of their replacement.

use super::*;
use crate::node::Ended;
use gdp_link::link::REQUEST_TIMEOUT;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_flow_over_the_end_of_certificates_that_are_renewed() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let soon = unix_seconds() + 5;
    let short = owner.grant_until(&cloud, 1, soon);
    let mut subscription = cloud.subscribe(owner.card().proof(), short, SubscribeOptions::reliable()).await.unwrap();
    let short = owner.ad_cert_until(robot.name(), 1, soon);
    let mut publisher = robot.publish(owner.card().proof(), short, PublishOptions::reliable()).await.unwrap();
    publisher.send(Encoding::Bytes, b"before").await.unwrap();
    let first = recv(&mut subscription).await;
    publisher.renew(owner.ad_cert_until(robot.name(), 2, soon + 60)).await.unwrap();
    subscription.renew(owner.grant_until(&cloud, 2, soon + 60)).await.unwrap();
    let mut count = 1;
    while unix_seconds() <= soon + 1 {
        publisher.send(Encoding::Bytes, b"on and on").await.unwrap();
        let message = recv(&mut subscription).await;
        count += 1;
        assert_eq!((message.session, message.sequence), (first.session, first.sequence + count - 1));
    }
    assert_eq!(publisher.readers(), 1);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_a_right_to_the_same_renews_and_a_refusal_leaves_the_old_one() {
    let fabric = Fabric::start().await;
    let (owner, other) = (Owner::new("/chatter"), Owner::new("/other"));
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut publisher = owner.publish(&robot).await.unwrap();
    let mut subscription = owner.subscribe(&cloud).await.unwrap();
    for wrong in [other.ad_cert(robot.name()), owner.ad_cert(cloud.name()), owner.ad_cert_until(robot.name(), 2, 1)] {
        assert!(matches!(publisher.renew(wrong).await, Err(NodeError::Cert(_))));
    }
    assert!(matches!(subscription.renew(other.grant_until(&cloud, 2, u64::MAX)).await, Err(NodeError::Cert(_))));
    fabric.refuse(Some(RefusalCode::NotEntitled));
    let error = publisher.renew(owner.ad_cert_until(robot.name(), 2, u64::MAX)).await.unwrap_err();
    assert!(matches!(&error, NodeError::Refused(refusal) if refusal.code == RefusalCode::NotEntitled), "{error}");
    fabric.refuse(None);
    fabric.revoke(owner.revocation(1, vec![2])).await;
    publisher.send(Encoding::Bytes, b"by the old one").await.unwrap();
    assert_eq!(&recv(&mut subscription).await.body[..], b"by the old one");
    assert!(matches!(
        publisher.renew(owner.ad_cert_until(robot.name(), 2, u64::MAX)).await,
        Err(NodeError::Cert(CertError::Revoked { serial: 2, .. }))
    ));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_renewal_that_meets_with_something_that_passes_is_made_later() {
    for passes in [RefusalCode::Limit, RefusalCode::NotAttached, RefusalCode::Unreachable] {
        let fabric = Fabric::start().await;
        let owner = Owner::new("/chatter");
        let robot = fabric.node("proxy").await;
        let mut publisher = owner.publish(&robot).await.unwrap();
        fabric.refuse(Some(passes));
        publisher.renew(owner.ad_cert_until(robot.name(), 2, unix_seconds() + 60)).await.unwrap();
        assert_eq!(fabric.write_serials(owner.name()), [1]);
        fabric.refuse(None);
        eventually("the RIB has the new one", || fabric.write_serials(owner.name()) == [2]).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_renewed_once_the_node_is_closed() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/chatter");
    let robot = fabric.node("proxy").await;
    let mut publisher = owner.publish(&robot).await.unwrap();
    robot.close().await;
    let renewed = publisher.renew(owner.ad_cert_until(robot.name(), 2, unix_seconds() + 60)).await;
    assert!(matches!(renewed, Err(NodeError::Closed)), "{renewed:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn servers_and_clients_renew_too() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/add");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let soon = unix_seconds() + 5;
    let mut server = robot.serve(owner.card().proof(), owner.ad_cert_until(robot.name(), 1, soon)).await.unwrap();
    let client = cloud.client(owner.card().proof(), owner.grant_until(&cloud, 1, soon)).await.unwrap();
    server.renew(owner.ad_cert_until(robot.name(), 2, soon + 60)).await.unwrap();
    client.renew(owner.grant_until(&cloud, 2, soon + 60)).await.unwrap();
    eventually("the first have ended", || unix_seconds() > soon + 1).await;
    let (reply, served) = tokio::join!(client.call(Encoding::Bytes, b"1 + 1"), async {
        server.recv().await.unwrap().reply(Encoding::Bytes, b"2").await
    });
    served.unwrap();
    assert_eq!(&reply.unwrap().body[..], b"2");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn handles_tell_that_they_ended_and_why() {
    let fabric = Fabric::start().await;
    let [topic, service, revoked] = ["/chatter", "/add", "/stolen"].map(Owner::new);
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let soon = unix_seconds() + 5;
    let (proof, options) = (topic.card().proof(), PublishOptions::reliable());
    let publisher = robot.publish(proof, topic.ad_cert_until(robot.name(), 1, soon), options).await.unwrap();
    let grant = topic.grant_until(&cloud, 1, soon);
    let mut subscription = cloud.subscribe(proof, grant, SubscribeOptions::reliable()).await.unwrap();
    let proof = service.card().proof();
    let server = robot.serve(proof, service.ad_cert_until(robot.name(), 1, soon)).await.unwrap();
    let client = cloud.client(proof, service.grant_until(&cloud, 1, soon)).await.unwrap();
    let stolen = revoked.publish(&robot).await.unwrap();
    let kept = revoked.subscribe_by(&cloud, 9, SubscribeOptions::reliable()).await.unwrap();

    let (stolen_ended, kept_ended) = (tokio::spawn(stolen.ended()), tokio::spawn(kept.ended()));
    fabric.revoke(revoked.revocation(1, vec![1])).await;
    let why = stolen_ended.await.unwrap();
    assert!(matches!(why, Ended::Right(CertError::Revoked { serial: 1, .. })), "{why}");

    let ends: [std::pin::Pin<Box<dyn Future<Output = Ended> + Send>>; 4] = [
        Box::pin(publisher.ended()),
        Box::pin(subscription.ended()),
        Box::pin(server.ended()),
        Box::pin(client.ended()),
    ];
    for end in ends {
        let why = tokio::time::timeout(TIMEOUT, end).await.expect("in time");
        assert!(matches!(why, Ended::Right(CertError::Expired { .. })), "{why}");
    }
    assert!(subscription.recv().await.is_none());
    assert!(!kept_ended.is_finished());
    cloud.close().await;
    assert_eq!(kept_ended.await.unwrap(), Ended::Closed);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rights_end_in_time_while_the_rib_does_not_answer() {
    let fabric = Fabric::start().await;
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let owners = [(); 4].map(|()| Owner::new("/chatter"));
    let (mut publishers, mut subscriptions) = (Vec::new(), Vec::new());
    for owner in &owners {
        publishers.push(owner.publish(&robot).await.unwrap());
    }
    let (short, soon) = (Owner::new("/short"), unix_seconds() + 3);
    let cert = short.ad_cert_until(robot.name(), 1, soon);
    let publisher = robot.publish(short.card().proof(), cert, PublishOptions::reliable()).await.unwrap();
    fabric.mute(&robot, 0);
    // Each subscription requires key boxes to be stored.
    for owner in &owners {
        subscriptions.push(owner.subscribe(&cloud).await.unwrap());
    }
    publisher.ended().await;
    let late = unix_seconds() - soon;
    assert!(late < REQUEST_TIMEOUT.as_secs(), "{late} s");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_starts_anew_has_forgotten_no_revocation() {
    let mut fabric = Fabric::start().await;
    let (owner, folder) = (Owner::new("/chatter"), tempfile::tempdir().unwrap());
    let (robot, cloud) = (Identity::generate("proxy").unwrap(), Identity::generate("proxy").unwrap());
    let state = || Some(folder.path().to_owned());
    {
        let (robot, cloud) =
            (fabric.node_of(&robot, [None], None).await, fabric.node_of(&cloud, [None], state()).await);
        let publisher = owner.publish(&robot).await.unwrap();
        let subscription = owner.subscribe_by(&cloud, 9, SubscribeOptions::reliable()).await.unwrap();
        fabric.revoke(owner.revocation(1, vec![1, 9])).await;
        tokio::time::timeout(TIMEOUT, publisher.ended()).await.expect("in time");
        tokio::time::timeout(TIMEOUT, subscription.ended()).await.expect("in time");
        robot.close().await;
        cloud.close().await;
    }
    // All state except that of one node is lost.
    fabric.stop().await;
    fabric.restart().await;
    let (robot, cloud) = (fabric.node_of(&robot, [None], None).await, fabric.node_of(&cloud, [None], state()).await);
    let error = owner.subscribe_by(&cloud, 9, SubscribeOptions::reliable()).await.err().unwrap();
    assert!(matches!(error, NodeError::Cert(CertError::Revoked { serial: 9, .. })), "{error}");
    let mut subscription = owner.subscribe_by(&cloud, 10, SubscribeOptions::reliable()).await.unwrap();
    eventually("it is passed on to the RIB", || fabric.told_revocations() > 0).await;
    let mut publisher = owner.publish(&robot).await.expect("the robot does not know, nor does this RIB");
    publisher.send(Encoding::Bytes, b"stolen").await.unwrap();
    eventually("it is dropped", || cloud.counters().drops.contains_key("seal_unknown_writer")).await;
    publisher.renew(owner.ad_cert_until(robot.name(), 2, unix_seconds() + 60)).await.unwrap();
    publisher.send(Encoding::Bytes, b"by another right").await.unwrap();
    // The robot had also sealed the earlier messages for this reader.
    while &recv(&mut subscription).await.body[..] != b"by another right" {}
}
