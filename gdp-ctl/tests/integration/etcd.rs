//! The store on a real etcd. The tests cover leader election, writes by the leader and reads by
//! others, fencing of former leaders, and copies across compaction and restarts.

use std::time::Duration;

use gdp_daemon::store::{
    Access, Endpoint, StoreError, client::EtcdClient, client::Watch, items::Copy, items::ItemWriter, items::KeySpace,
    kv::Op, kv::WatchEvent,
};
use gdp_rib::rib::Item;
use gdp_wire::Name;
use tokio::time::timeout;

use crate::cluster::Cluster;

/// Lifetimes in seconds of leases that are not renewed: longer than any test, and short enough to
/// wait for its end.
const LONG: u64 = 300;
const SHORT: u64 = 5;

#[tokio::test]
async fn an_old_leader_changes_nothing_and_a_new_one_has_everything() {
    let cluster = Cluster::start(1);
    let mut one = Replica::new(&cluster, 1).await;
    let mut two = Replica::new(&cluster, 2).await;
    let mut first = one.elected().await.expect("there is no leader");
    assert!(two.elected().await.is_none(), "there is one");
    assert!(two.place.has_leader(&mut two.client).await.unwrap());

    written(&mut first, &[put(1, b"a"), put(2, b"b"), put(3, b"c")]).await;
    written(&mut first, &[put(1, b"a2"), (item(2), None), (item(9), None)]).await;
    let expected = [(item(1), b"a2".to_vec()), (item(3), b"c".to_vec())];
    two.catch_up(&expected).await;

    one.client.revoke(one.lease).await.unwrap();
    two.leader_gone().await;
    let mut second = two.elected().await.expect("the other has resigned");
    let fenced = first.write(&[put(1, b"late")]).await;
    assert!(matches!(fenced, Err(StoreError::Fenced)), "{fenced:?}");
    let asked = first.write(&[]).await;
    assert!(matches!(asked, Err(StoreError::Fenced)), "nor does it say that it leads: {asked:?}");
    second.write(&[]).await.unwrap();
    written(&mut second, &[put(1, b"a3")]).await;
    one.list().await;
    assert_eq!(one.items(), [(item(1), b"a3".to_vec()), (item(3), b"c".to_vec())]);
}

#[tokio::test]
async fn a_leader_is_gone_with_its_lease() {
    let cluster = Cluster::start(1);
    let mut one = Replica::new(&cluster, 1).await;
    let mut two = Replica::new(&cluster, 2).await;
    one.ttl = SHORT;
    let mut writer = one.elected().await.unwrap();
    assert!(one.client.keep_alive(one.lease).await.unwrap());
    two.leader_gone().await;
    assert!(two.elected().await.is_some());
    assert!(!one.client.keep_alive(one.lease).await.unwrap());
    assert!(matches!(writer.write(&[put(1, b"late")]).await, Err(StoreError::Fenced)));
}

#[tokio::test]
async fn what_the_leader_says_counts_whoever_meddles_or_if_an_answer_is_lost() {
    let cluster = Cluster::start(1);
    let mut one = Replica::new(&cluster, 1).await;
    let mut writer = one.elected().await.unwrap();
    written(&mut writer, &[put(1, b"a"), put(2, b"b")]).await;
    for meddled in [Some(b"x"), None] {
        let key = one.place.key(&item(1));
        let op = match meddled {
            Some(value) => Op::Put { key: &key, value, lease: 0 },
            None => Op::Delete(&key),
        };
        assert!(one.client.transact(&[], &[op], &[]).await.unwrap().succeeded);
        written(&mut writer, &[put(1, b"a2"), (item(2), None)]).await;
        one.list().await;
        assert_eq!(one.items(), [(item(1), b"a2".to_vec())]);
    }
}

#[tokio::test]
async fn many_and_large_items_go_in_parts() {
    let cluster = Cluster::start(1);
    let mut one = Replica::new(&cluster, 1).await;
    let mut two = Replica::new(&cluster, 2).await;
    let mut writer = one.elected().await.unwrap();
    let mut changes: Vec<_> = (0..600).map(|i| put(i, &[i as u8; 100])).collect();
    changes.extend((600..640).map(|i| put(i, &[i as u8; 60_000])));
    written(&mut writer, &changes).await;
    let expected: Vec<_> = changes.iter().map(|(item, value)| (*item, value.clone().unwrap())).collect();
    two.catch_up(&expected).await;
    two.list().await;
    assert!(two.items() == expected);
}

#[tokio::test]
async fn what_was_compacted_is_listed_anew() {
    let cluster = Cluster::start(1);
    let mut one = Replica::new(&cluster, 1).await;
    let mut two = Replica::new(&cluster, 2).await;
    let mut writer = one.elected().await.unwrap();
    for value in [b"a", b"b", b"c"] {
        written(&mut writer, &[put(1, value)]).await;
    }
    one.list().await;
    cluster.etcdctl(&[0], &["compaction", &one.copy.revision().to_string()]);
    let mut watch = two.client.watch(two.place.prefix(), 2).await.unwrap();
    let followed = next(&mut watch).await;
    assert!(matches!(followed, Err(StoreError::Compacted)), "{followed:?}");
    two.list().await;
    assert_eq!(two.items(), [(item(1), b"c".to_vec())]);
}

#[tokio::test]
async fn a_restart_of_etcd_loses_nothing_and_one_member_may_be_gone() {
    let mut cluster = Cluster::start(3);
    let mut one = Replica::new(&cluster, 1).await;
    let mut writer = one.elected().await.unwrap();
    written(&mut writer, &[put(1, b"a")]).await;
    // Kill the first configured member, and then another.
    cluster.kill(0);
    written(&mut writer, &[put(2, b"b")]).await;
    cluster.kill(1);
    let refused = writer.write(&[put(3, b"c")]).await.unwrap_err();
    assert!(refused.to_string().contains("etcd"), "{refused}");
    cluster.restart(1);
    written(&mut writer, &[put(3, b"c")]).await;
    cluster.restart(0);
    one.list().await;
    assert_eq!(one.items(), [(item(1), b"a".to_vec()), (item(2), b"b".to_vec()), (item(3), b"c".to_vec())]);
}

struct Replica {
    name: Name,
    endpoints: Vec<Endpoint>,
    client: EtcdClient,
    place: KeySpace,
    copy: Copy,
    watch: Watch,
    lease: i64,
    /// Lifetime of its leases in seconds.
    ttl: u64,
}

impl Replica {
    async fn new(cluster: &Cluster, index: u8) -> Self {
        let endpoints = cluster.endpoints();
        let (mut client, place) = (client(&endpoints), KeySpace::new("test/rib"));
        let copy = Copy::list(&place, &mut client).await.unwrap();
        let watch = client.watch(place.prefix(), copy.revision() + 1).await.unwrap();
        Self { name: Name::from_bytes([index; 32]), endpoints, client, place, copy, watch, lease: 0, ttl: LONG }
    }

    async fn list(&mut self) {
        self.copy = Copy::list(&self.place, &mut self.client).await.unwrap();
    }

    fn items(&self) -> Vec<(Item, Vec<u8>)> {
        self.copy.items().map(|(item, value)| (*item, value.to_vec())).collect()
    }

    /// Stands for election. Returns a writer if elected.
    async fn elected(&mut self) -> Option<ItemWriter> {
        self.lease = self.client.grant(self.ttl).await.unwrap();
        let term = self.place.stand(&mut self.client, &self.name, self.lease).await.unwrap()?;
        // The answer may be lost, so a repeated request must give the same result.
        assert_eq!(self.place.stand(&mut self.client, &self.name, self.lease).await.unwrap(), Some(term));
        let copy = Copy::list(&self.place, &mut self.client).await.unwrap();
        Some(copy.into_writer(client(&self.endpoints), term))
    }

    async fn catch_up(&mut self, expected: &[(Item, Vec<u8>)]) {
        while self.items() != expected {
            self.copy.apply(next(&mut self.watch).await.unwrap()).unwrap();
        }
    }

    async fn leader_gone(&mut self) {
        while !self.copy.apply(next(&mut self.watch).await.unwrap()).unwrap() {}
    }
}

fn client(endpoints: &[Endpoint]) -> EtcdClient {
    EtcdClient::new(endpoints, &Access::default()).unwrap()
}

/// Waits for the next change, long enough for a lease to end.
async fn next(watch: &mut Watch) -> Result<Vec<WatchEvent>, StoreError> {
    timeout(Duration::from_secs(30), watch.next()).await.expect("something changes")
}

/// Writes, retrying until the cluster has elected a new leader after losing a member, and a slow
/// disk has stored the data.
async fn written(writer: &mut ItemWriter, changes: &[(Item, Option<Vec<u8>>)]) {
    let attempts = async {
        while let Err(error) = writer.write(changes).await {
            assert!(matches!(error, StoreError::Unreachable { .. }), "{error}");
        }
    };
    timeout(Duration::from_secs(30), attempts).await.expect("two of three are a cluster");
}

fn item(index: u64) -> Item {
    Item::Invitation(index)
}

fn put(index: u64, value: &[u8]) -> (Item, Option<Vec<u8>>) {
    (item(index), Some(value.to_vec()))
}
