//! Nodes of the SDK at a whole daemon: what two callers of one service get, and what is left when the server goes.

mod owner;
mod switch;

use std::time::SystemTime;

use gdp::cert::{AdCert, Grantee, Mode, ReadGrant, issue};
use gdp::node::{Client, NodeError, Server};
use gdp::seal::Encoding;
use gdp::{Identity, Node, NodeConfig};
use gdp_ctl::serve::{Running, start};
use owner::Owner;
use switch::{PATIENCE, config, wait};

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
            let reply = tokio::time::timeout(PATIENCE, client.call(Encoding::Cdr, &body)).await.unwrap().unwrap();
            assert_eq!((&reply.body[..], reply.encoding), (&body[..], Encoding::Cdr));
        }
    }
    // One that comes later is served as well.
    let late = owner.client(&node(&switch).await).await;
    tokio::time::timeout(PATIENCE, late.call(Encoding::Cdr, b"late")).await.unwrap().unwrap();
    drop(serving.await.unwrap());
    wait("the server to be gone", async || one.servers() == 0).await;
    assert!(matches!(one.call(Encoding::Cdr, b"").await, Err(NodeError::NoServer(_))));
    switch.stop().await;
}

/// Sends so many requests back.
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
        let (name, entity, mode, scope) = (self.card.name(), node.name(), Mode::Unicast, Vec::new());
        let claims = AdCert { name, entity, mode, scope, serial: 1, not_before: 0, not_after: tomorrow() };
        node.serve(self.card.proof(), issue(&self.key, &claims).unwrap().into()).await.unwrap()
    }

    async fn client(&self, node: &Node) -> Client {
        let (name, to, not_after) = (self.card.name(), Grantee::Entity(node.name()), tomorrow());
        let grant = issue(&self.key, &ReadGrant { name, to, serial: 1, not_before: 0, not_after }).unwrap();
        node.client(self.card.proof(), grant.into()).await.unwrap()
    }
}

async fn node(switch: &Running) -> Node {
    let link = format!("udp://{}", switch.udp_addr().unwrap()).parse().unwrap();
    Node::connect(NodeConfig::new(Identity::generate("proxy").unwrap(), link)).await.unwrap()
}

fn tomorrow() -> u64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs() + 24 * 3600
}
