//! Nodes of the SDK at whole daemons: replies to two callers of one service, the state after a
//! server ends, and the choice between several servers.

use std::sync::Arc;
use std::time::SystemTime;

use crate::owner::Owner;
use crate::ports::free_addr;
use crate::switch::{TIMEOUT, config, wait};
use gdp::unstable::{Client, Node, NodeConfig, NodeError, Server};
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::Identity;
use gdp_daemon::config::{Config, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve::{Running, start};
use gdp_e2e::seal::{Encoding, Message};

#[tokio::test(flavor = "multi_thread")]
async fn callers_get_their_own_replies_and_are_told_when_nobody_serves() {
    let folder = tempfile::tempdir().unwrap();
    let switch = start(config(folder.path(), "s1")).await.unwrap();
    let owner = Owner::new("service", "/echo");
    let server = owner.serve(&node(&switch).await).await;
    let (one, two) = (owner.client(&node(&switch).await).await, owner.client(&node(&switch).await).await);
    let serving = tokio::spawn(answer(server, 21));
    for i in 0..10u8 {
        for (client, body) in [(&one, vec![i; 3]), (&two, vec![i; 30_000])] {
            let reply = tokio::time::timeout(TIMEOUT, client.call(Encoding::Cdr, &body)).await.unwrap().unwrap();
            assert_eq!((&reply.body[..], reply.encoding), (&body[..], Encoding::Cdr));
        }
    }
    // A caller that joins later is served as well.
    let late = owner.client(&node(&switch).await).await;
    tokio::time::timeout(TIMEOUT, late.call(Encoding::Cdr, b"late")).await.unwrap().unwrap();
    drop(serving.await.unwrap());
    wait("the server to be gone", async || one.servers() == 0).await;
    assert!(matches!(one.call(Encoding::Cdr, b"").await, Err(NodeError::NoServer(_))));
    switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_nearest_server_is_called_and_another_when_it_is_gone() {
    // caller – s1 (RIB) – s2 – s3, with a server at each of the last two.
    let folder = tempfile::tempdir().unwrap();
    let switches = chain(folder.path()).await;
    let owner = Owner::new("service", "/plan");
    let (near_identity, caller) = (Identity::generate("proxy").unwrap(), node(&switches[0]).await);
    let (near, far) = (node_of(&switches[1], near_identity.clone()).await, node(&switches[2]).await);
    let (near_name, far_name) = (near.name(), far.name());
    let mut near_server = owner.serve(&near).await;
    let _far_serving = AbortOnDrop(tokio::spawn(answer(owner.serve(&far).await, usize::MAX)));
    let client = Arc::new(owner.client(&caller).await);
    let order = || client.instances().iter().map(|one| (one.name, one.cost)).collect::<Vec<_>>();
    wait("what paths cost", async || order() == [(near_name, Some(1)), (far_name, Some(2))]).await;

    for i in 0..10u8 {
        let call = tokio::spawn(call(client.clone(), vec![i; 3000]));
        let request = tokio::time::timeout(TIMEOUT, near_server.recv()).await.unwrap().unwrap();
        request.reply(Encoding::Cdr, &[i]).await.unwrap();
        assert_eq!(call.await.unwrap().unwrap().writer, near_name);
    }
    assert_eq!(far.counters().messages_received, 0);

    // The server ends while a call is pending.
    let waiting = tokio::spawn(call(client.clone(), b"last".to_vec()));
    let _request = tokio::time::timeout(TIMEOUT, near_server.recv()).await.unwrap().unwrap();
    near.close().await;
    let failed = tokio::time::timeout(TIMEOUT, waiting).await.unwrap().unwrap();
    assert!(matches!(failed, Err(NodeError::InstanceLeft { instance, .. }) if instance == near_name), "{failed:?}");
    assert_eq!(far.counters().messages_received, 0, "it is sent to no other");
    assert_eq!(call(client.clone(), b"next".to_vec()).await.unwrap().writer, far_name);
    drop((near_server, near));

    // The server returns, and a second server starts at the same switch.
    let (near, twin) = (node_of(&switches[1], near_identity).await, node(&switches[1]).await);
    let (mut near_server, mut twin_server) = (owner.serve(&near).await, owner.serve(&twin).await);
    wait("both to be known", async || {
        let costs: Vec<_> = client.instances().iter().map(|one| one.cost).collect();
        costs == [Some(1), Some(1), Some(2)]
    })
    .await;
    let calls = [b"one", b"two"].map(|body| tokio::spawn(call(client.clone(), body.to_vec())));
    // Answer neither server's request before both have one. Otherwise the first server would be
    // free for both calls.
    let mut requests = Vec::new();
    for server in [&mut near_server, &mut twin_server] {
        requests.push(tokio::time::timeout(TIMEOUT, server.recv()).await.unwrap().unwrap());
    }
    for request in requests {
        request.reply(Encoding::Cdr, b"shared").await.unwrap();
    }
    let mut writers = Vec::new();
    for call in calls {
        writers.push(call.await.unwrap().unwrap().writer);
    }
    assert!(writers.contains(&near_name) && writers.contains(&twin.name()));
    let pinned = tokio::time::timeout(TIMEOUT, client.call_at(far_name, Encoding::Cdr, b"there")).await.unwrap();
    assert_eq!(pinned.unwrap().writer, far_name);
    let [one, two, three] = switches;
    tokio::join!(one.stop(), two.stop(), three.stop());
}

async fn call(client: Arc<Client>, body: Vec<u8>) -> Result<Message, NodeError> {
    tokio::time::timeout(TIMEOUT, client.call(Encoding::Cdr, &body)).await.expect("in time")
}

/// Three switches in a row, each link of cost 1, with the RIB at the first.
async fn chain(folder: &std::path::Path) -> [Running; 3] {
    let label = |i: usize| format!("s{i}");
    let places = [0, 1, 2].map(|i| {
        let switch = Identity::load_or_generate(&folder.join(format!("{}.pem", label(i))), "switch").unwrap().name();
        NeighbourAddress { switch, via: Via::Udp(free_addr()) }
    });
    let mut running = Vec::new();
    for (i, place) in places.iter().enumerate() {
        let Via::Udp(addr) = place.via else { unreachable!("over UDP") };
        let near =
            |j: usize, dial| Neighbour { address: places[j].clone(), cost: Some(1), dial, parent: false, tls: None };
        let before = i.checked_sub(1).map(|j| near(j, true));
        let behind = (i + 1 < places.len()).then(|| near(i + 1, false));
        let neighbours = before.into_iter().chain(behind).collect();
        let config = Config { udp: Some(addr), rib: i == 0, neighbours, ..config(folder, &label(i)) };
        running.push(start(config).await.unwrap());
    }
    running.try_into().unwrap_or_else(|_| unreachable!("as many as places"))
}

struct AbortOnDrop<T>(tokio::task::JoinHandle<T>);

impl<T> Drop for AbortOnDrop<T> {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Echoes `count` requests.
async fn answer(mut server: Server, count: usize) -> Server {
    for _ in 0..count {
        let call = server.recv().await.unwrap();
        let (encoding, body) = (call.encoding(), call.body().clone());
        call.reply(encoding, &body).await.unwrap();
    }
    server
}

impl Owner {
    async fn serve(&self, node: &Node) -> Server {
        let (name, entity, scope) = (self.card.name(), node.name(), Vec::new());
        let claims = AdCert { name, entity, scope, serial: 1, not_before: 0, not_after: tomorrow() };
        node.serve(self.card.proof(), issue(&self.key, &claims).unwrap().into()).await.unwrap()
    }

    async fn client(&self, node: &Node) -> Client {
        let (name, to, not_after) = (self.card.name(), Grantee::Entity(node.name()), tomorrow());
        let grant = issue(&self.key, &ReadGrant { name, to, serial: 1, not_before: 0, not_after }).unwrap();
        node.client(self.card.proof(), grant.into()).await.unwrap()
    }
}

async fn node(switch: &Running) -> Node {
    node_of(switch, Identity::generate("proxy").unwrap()).await
}

async fn node_of(switch: &Running, identity: Identity) -> Node {
    let link = format!("udp://{}", switch.udp_addr().unwrap()).parse().unwrap();
    Node::connect(NodeConfig::new(identity, link)).await.unwrap()
}

fn tomorrow() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs() + 24 * 3600
}
