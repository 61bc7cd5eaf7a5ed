//! A RIB replica that is stopped while etcd elects it. Without the answer, the replica does not
//! know that it was elected.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use gdp_daemon::config::{Config, EtcdConfig};
use gdp_daemon::serve::start;
use gdp_daemon::store::client::EtcdClient;
use gdp_daemon::store::items::KeySpace;
use gdp_daemon::store::{Access, Endpoint};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::time::timeout;

use crate::cluster::Cluster;
use crate::switch::{TIMEOUT, config, wait};

/// Contents of every request that writes the leader's key, and of no other: the key, then the tag
/// of the value (`PutRequest` in etcd's `rpc.proto`).
const PUT: &[u8] = b"test//leader\x12";

#[tokio::test(flavor = "multi_thread")]
async fn a_replica_that_resigns_while_it_is_elected_leaves_no_leader() {
    let (cluster, folder, stands) = (Cluster::start(1), tempfile::tempdir().unwrap(), Arc::new(Notify::new()));
    let endpoints = vec![relay(cluster.endpoints()[0].clone(), stands.clone()).await];
    let etcd = Some(EtcdConfig { endpoints, prefix: "test/".into(), access: Access::default() });
    let switch = start(Config { etcd, ..config(folder.path(), "s1") }).await.unwrap();
    timeout(TIMEOUT, stands.notified()).await.expect("it stands for election");
    let (place, client) =
        (KeySpace::new("test/"), || EtcdClient::new(&cluster.endpoints(), &Access::default()).unwrap());
    wait("the election", async || place.has_leader(&mut client()).await.unwrap()).await;
    switch.resign().await;
    // Without resigning, its lease would last for seconds.
    assert!(!place.has_leader(&mut client()).await.unwrap(), "others may stand");
    switch.stop().await;
}

/// Relays requests to a member of etcd, and the answers. It withholds answers on connections with a
/// write to the leader's key.
async fn relay(to: Endpoint, puts: Arc<Notify>) -> Endpoint {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let port = listener.local_addr().unwrap().port();
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            let (to, puts) = (to.clone(), puts.clone());
            tokio::spawn(async move {
                let far = TcpStream::connect((to.host.as_str(), to.port)).await.unwrap();
                pass_on(near, far, &puts).await;
            });
        }
    });
    Endpoint { tls: false, host: "127.0.0.1".into(), port }
}

async fn pass_on(near: TcpStream, far: TcpStream, puts: &Notify) {
    let ((mut from_near, mut to_near), (mut from_far, mut to_far)) = (near.into_split(), far.into_split());
    let is_held = AtomicBool::new(false);
    let ask = async {
        let mut bytes = vec![0; 64 << 10];
        while let Ok(length @ 1..) = from_near.read(&mut bytes).await {
            let is_put = bytes[..length].windows(PUT.len()).any(|window| window == PUT);
            is_held.fetch_or(is_put, Ordering::SeqCst);
            if to_far.write_all(&bytes[..length]).await.is_err() {
                break;
            }
            if is_put {
                puts.notify_one();
            }
        }
    };
    let answer = async {
        let mut bytes = vec![0; 64 << 10];
        while let Ok(length @ 1..) = from_far.read(&mut bytes).await {
            if !is_held.load(Ordering::SeqCst) && to_near.write_all(&bytes[..length]).await.is_err() {
                break;
            }
        }
    };
    // The connection ends when either direction ends.
    tokio::select! { () = ask => {} () = answer => {} }
}
