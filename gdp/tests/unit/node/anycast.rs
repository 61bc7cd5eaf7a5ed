//! Tests of a service with several servers: the selection of a server, pinned calls, and the
//! authorisation of callers.

use std::collections::BTreeMap;

use gdp_wire::Name;

use super::fabric::{Fabric, Owner, eventually};
use super::*;
use gdp_e2e::seal::{Draft, Message};

const SEGMENT: u8 = gdp_e2e::seal::SEGMENT_VERSION;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn calls_are_shared_and_each_stays_with_its_server() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/plan");
    let (one, two, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await, fabric.node("proxy").await);
    let servers = [owner.serve(&one).await, owner.serve(&two).await];
    let client = Arc::new(owner.client(&cloud).await);
    assert_eq!(client.servers(), 2);
    let mut changes = client.changes();
    let seen = requests_seen(&fabric, &cloud);
    let first = client.instances()[0].name;
    let (mut near, mut other) = servers.into();
    if first != one.name() {
        (near, other) = (other, near);
    }
    let (near_name, other_name) = if first == one.name() { (one.name(), two.name()) } else { (two.name(), one.name()) };

    let waiting = tokio::spawn(call(client.clone(), b"where to?"));
    let unanswered = soon(near.recv()).await.unwrap();
    assert_eq!((unanswered.client(), &unanswered.body()[..]), (cloud.name(), &b"where to?"[..]));
    assert_eq!(seen(other_name), 0, "who is not called receives nothing of it");
    assert_eq!(
        client.instances().iter().map(|one| (one.name, one.waiting)).collect::<Vec<_>>(),
        [(other_name, 0), (near_name, 1)]
    );
    let (reply, ()) = tokio::join!(soon(client.call(Encoding::Bytes, b"and then?")), echo(&mut other));
    assert_eq!(reply.unwrap().writer, other_name);
    let (reply, ()) = tokio::join!(soon(client.call_at(near_name, Encoding::Bytes, b"pinned")), echo(&mut near));
    let reply = reply.unwrap();
    assert_eq!((reply.writer, &reply.body[..]), (near_name, &b"pinned"[..]));

    // The server leaves. Its outstanding call fails at once and is not sent to another server.
    let before = seen(other_name);
    assert!(!changes.has_changed().unwrap(), "the same two all the while");
    drop(near);
    soon(changes.changed()).await.unwrap();
    assert_eq!(client.instances().iter().map(|one| one.name).collect::<Vec<_>>(), [other_name]);
    let failed = soon(waiting).await.unwrap().unwrap_err();
    let expected = (owner.name(), near_name);
    assert!(
        matches!(failed, NodeError::InstanceLeft { service, instance } if (service, instance) == expected),
        "{failed}"
    );
    assert_eq!(seen(other_name), before);
    assert!(cloud.0.state.calls.lock().is_empty());
    let pinned = client.call_at(near_name, Encoding::Bytes, b"pinned").await;
    assert!(matches!(pinned, Err(NodeError::NoInstance { instance, .. }) if instance == near_name), "{pinned:?}");
    let (reply, ()) = tokio::join!(soon(client.call(Encoding::Bytes, b"next")), echo(&mut other));
    assert_eq!(reply.unwrap().writer, other_name);

    // The server returns.
    let mut near = owner.serve(if near_name == one.name() { &one } else { &two }).await;
    soon(changes.changed()).await.unwrap();
    assert_eq!((client.servers(), client.instances()[0].name), (2, near_name));
    let (reply, ()) = tokio::join!(soon(client.call(Encoding::Bytes, b"again")), echo(&mut near));
    assert_eq!(reply.unwrap().writer, near_name);
    drop(unanswered);
    drop(client);
    // The remaining server leaves. After that the channel closes.
    while soon(changes.changed()).await.is_ok() {}
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_has_one_id_at_both_ends_and_another_may_name_it() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/plan");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let mut server = owner.serve(&robot).await;
    let client = owner.client(&cloud).await;
    let (begun, mut id) = tokio::sync::oneshot::channel();
    let asking = client.call_at_with(robot.name(), Encoding::Bytes, b"where to?", move |id| _ = begun.send(id));
    let asked = tokio::select! {
        call = soon(server.recv()) => call.unwrap(),
        reply = asking => panic!("nobody replied: {reply:?}"),
    };
    assert_eq!(Ok(asked.id()), id.try_recv());
    // The call is dropped now, and the notification has no reply.
    client.notify_at(robot.name(), Encoding::Bytes, b"never mind").await.unwrap();
    assert_eq!(&soon(server.recv()).await.unwrap().body()[..], b"never mind");
    asked.reply(Encoding::Bytes, b"left").await.unwrap();
    assert_eq!(client.instances()[0].waiting, 0);
    assert!(cloud.0.state.calls.lock().is_empty());
    let nowhere = client.notify_at(cloud.name(), Encoding::Bytes, b"").await;
    assert!(matches!(nowhere, Err(NodeError::NoInstance { .. })), "{nowhere:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_call_fails_at_once_when_its_server_is_revoked() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/plan");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let cert = owner.ad_cert_until(robot.name(), 7, unix_seconds() + 60);
    let mut server = robot.serve(owner.card().proof(), cert).await.unwrap();
    let client = Arc::new(owner.client(&cloud).await);
    let waiting = tokio::spawn(call(client.clone(), b"where to?"));
    let _call = soon(server.recv()).await.unwrap();
    fabric.revoke(owner.revocation(1, vec![7])).await;
    let failed = soon(waiting).await.unwrap();
    assert!(matches!(failed, Err(NodeError::InstanceLeft { .. })), "{failed:?}");
    assert!(soon(server.recv()).await.is_none());
    assert!(matches!(client.call(Encoding::Bytes, b"x").await, Err(NodeError::NoServer(_))));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_paths_cost_is_heard_when_it_changes() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/plan");
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let _server = owner.serve(&robot).await;
    fabric.set_costs(BTreeMap::from([(fabric.switch(), 3)])).await;
    let client = owner.client(&cloud).await;
    assert_eq!(client.instances()[0].cost, Some(3), "with the answer");
    fabric.set_costs(BTreeMap::from([(fabric.switch(), 4)])).await;
    assert_eq!(client.instances()[0].cost, Some(4));
    fabric.set_costs(BTreeMap::new()).await;
    assert_eq!(client.instances()[0].cost, None);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_may_call_one_service_does_not_call_another_of_the_same_server() {
    let fabric = Fabric::start().await;
    let [open, guarded, unknown] = ["/open", "/guarded", "/unknown"].map(Owner::new);
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let (mut server, mut guarded_server) = (open.serve(&robot).await, guarded.serve(&robot).await);
    let client = open.client(&cloud).await;
    let publication = cloud.0.state.send_path.publications.get(&robot.name()).unwrap();
    let forge = async |service: Name| {
        let draft = Draft { service: Some(service), ..Draft::new(Encoding::Bytes, b"open up") };
        publisher::send_through(&publication, &cloud.0.state.send_path, &[draft], |_| {}).await.unwrap()
    };
    let refused = || robot.counters().drops.get("drop_request_refused").copied().unwrap_or_default();
    forge(unknown.name()).await;
    eventually("it is not served here", || refused() == 1).await;
    forge(guarded.name()).await;
    eventually("it may not be called by this", || refused() == 2).await;
    // The caller is authorised after the RIB has announced its grant. That also applies to a
    // request from just before.
    forge(guarded.name()).await;
    let (reply, ()) = tokio::join!(soon(client.call(Encoding::Bytes, b"where to?")), echo(&mut server));
    assert_eq!(&reply.unwrap().body[..], b"where to?", "what came before was taken by now");
    let _guarded_client = guarded.client(&cloud).await;
    let early = soon(guarded_server.recv()).await.unwrap();
    assert_eq!((early.client(), &early.body()[..]), (cloud.name(), &b"open up"[..]));
    assert_eq!(refused(), 2);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_that_call_each_other_share_one_way_for_as_long_as_either_does() {
    let fabric = Fabric::start().await;
    let [up, down] = ["/up", "/down"].map(Owner::new);
    let (robot, cloud) = (fabric.node("proxy").await, fabric.node("proxy").await);
    let (mut at_robot, mut at_cloud) = (down.serve(&robot).await, up.serve(&cloud).await);
    let (from_robot, from_cloud) = (up.client(&robot).await, down.client(&cloud).await);
    let both = tokio::join!(
        soon(from_robot.call(Encoding::Bytes, b"up")),
        soon(from_cloud.call(Encoding::Bytes, b"down")),
        echo(&mut at_robot),
        echo(&mut at_cloud)
    );
    assert_eq!((&both.0.unwrap().body[..], &both.1.unwrap().body[..]), (&b"up"[..], &b"down"[..]));
    let has_way = |node: &Node, to: &Node| node.0.state.send_path.publications.get(&to.name()).is_some();
    drop((from_robot, at_cloud));
    let (reply, ()) = tokio::join!(soon(from_cloud.call(Encoding::Bytes, b"still")), echo(&mut at_robot));
    assert_eq!(&reply.unwrap().body[..], b"still");
    assert!(has_way(&robot, &cloud) && has_way(&cloud, &robot));
    drop(from_cloud);
    assert!(!has_way(&cloud, &robot), "it has no more to do with it");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_that_begins_anew_is_called_again() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/plan");
    let identity = Identity::generate("proxy").unwrap();
    let cloud = fabric.node("proxy").await;
    let client = owner.client(&cloud).await;
    for life in [[0], [1], [2]] {
        let robot = fabric.node_of(&identity, [None], None).await;
        let mut server = owner.serve(&robot).await;
        eventually("it serves", || client.servers() == 1).await;
        let (reply, ()) = tokio::join!(soon(client.call(Encoding::Bytes, &life)), echo(&mut server));
        assert_eq!((reply.unwrap().writer, client.servers()), (identity.name(), 1));
        drop(server);
        eventually("it is gone", || client.servers() == 0).await;
        robot.close().await;
    }
}

/// All listed servers can be called: their publications exist by then, also those of new and
/// returned servers.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_is_called_in_the_moment_in_which_it_is_there() {
    let fabric = Fabric::start().await;
    let owner = Owner::new("/plan");
    let old = Identity::generate("proxy").unwrap();
    let cloud = fabric.node("proxy").await;
    let client = Arc::new(owner.client(&cloud).await);
    for life in 0..20 {
        let identity = if life % 2 == 0 { old.clone() } else { Identity::generate("proxy").unwrap() };
        let robot = fabric.node_of(&identity, [None], None).await;
        let caller = client.clone();
        let called = tokio::spawn(async move {
            while caller.servers() == 0 {
                tokio::task::yield_now().await;
            }
            soon(caller.call(Encoding::Bytes, b"at once")).await
        });
        let mut server = owner.serve(&robot).await;
        let answered = async {
            echo(&mut server).await;
            Ok(())
        };
        let (reply, ()) = tokio::try_join!(async { called.await.unwrap() }, answered).unwrap();
        assert_eq!(reply.writer, identity.name(), "life {life}");
        drop(server);
        eventually("it is gone", || client.servers() == 0).await;
        robot.close().await;
    }
}

/// Returns a counter of the frames with sealed segments from a node to an entity.
fn requests_seen(fabric: &Fabric, from: &Node) -> impl Fn(Name) -> usize + use<> {
    let seen = Arc::<Mutex<Vec<Name>>>::default();
    let (from, tape) = (from.name(), seen.clone());
    fabric.set_fate(Some(Box::new(move |header, payload| {
        if header.source == from && payload.first() == Some(&SEGMENT) {
            tape.lock().push(header.destination);
        }
        true
    })));
    move |to| seen.lock().iter().filter(|destination| **destination == to).count()
}

async fn call(client: Arc<Client>, body: &'static [u8]) -> Result<Message, NodeError> {
    client.call(Encoding::Bytes, body).await
}

/// Replies to the next request with its body.
async fn echo(server: &mut Server) {
    let call = soon(server.recv()).await.unwrap();
    let body = call.body().clone();
    call.reply(Encoding::Bytes, &body).await.unwrap();
}

async fn soon<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(TIMEOUT, what).await.expect("in time")
}
