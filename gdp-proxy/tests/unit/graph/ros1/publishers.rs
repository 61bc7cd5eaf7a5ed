//! Unit tests of `graph::ros1::publishers`.

use super::*;

#[tokio::test]
async fn what_latches_nothing_shares_a_publisher_that_goes_with_the_last_who_has_it() {
    let site = Site::start().await;
    let (first, second) = (site.publish("/shared", false).await, site.publish("/shared", false).await);
    assert!(Arc::ptr_eq(&first, &second));
    let other = MessageType { name: "std_msgs/Int32".into(), ..kind() };
    let refused = site.publishers.publish(&site.main, "/shared", other, options(false)).await;
    assert!(matches!(refused, Err(GraphError::OtherType { .. })));
    for i in 0..10 {
        drop(site.publish(&format!("/t{i}"), false).await);
    }
    drop(site.publish("/last", false).await);
    assert_eq!(site.publishers.topics().len(), 2);
}

#[tokio::test]
async fn topics_share_the_further_nodes() {
    let site = Site::start().await;
    let mut publishers = Vec::new();
    for topic in ["/a", "/b", "/c"] {
        for _ in 0..3 {
            publishers.push(site.publish(topic, true).await);
        }
    }
    assert_eq!(site.publishers.made.load(Ordering::Relaxed), 2);
    let at = |index: usize| publishers[index]._further.as_ref();
    assert!(at(0).is_none() && at(3).is_none());
    assert!(Arc::ptr_eq(at(1).unwrap(), at(4).unwrap()) && !Arc::ptr_eq(at(1).unwrap(), at(2).unwrap()));
    publishers.clear();
    let (first, again) = (site.publish("/a", true).await, site.publish("/a", true).await);
    assert_eq!(
        (first._further.is_none(), again._further.is_some(), site.publishers.made.load(Ordering::Relaxed)),
        (true, true, 3)
    );
}

#[tokio::test]
async fn the_first_that_latches_is_at_the_main_node_and_the_others_have_their_own() {
    let site = Site::start().await;
    let (first, second) = (site.publish("/status", true).await, site.publish("/status", true).await);
    assert!(first._further.is_none() && second._further.is_some());
    let plain = [site.publish("/status", false).await, site.publish("/status", false).await];
    assert!(plain[0]._further.is_some() && Arc::ptr_eq(&plain[0], &plain[1]), "they share another one");
    drop((first, second, plain));
    assert!(site.publish("/status", true).await._further.is_none());
    site.publishers.leave().await;
}

#[tokio::test]
async fn who_comes_after_one_that_leaves_has_its_place_at_the_main_node() {
    let site = Site::start().await;
    let leaving = site.publish("/status", true).await;
    leaving.vacate();
    let next = site.publish("/status", true).await;
    assert!(Arc::ptr_eq(&leaving, &next));
    assert!(site.publish("/status", true).await._further.is_some(), "nobody leaves any more");
}

struct Site {
    main: Node,
    publishers: Publishers,
}

impl Site {
    async fn start() -> Self {
        // Nobody answers there.
        let variable = |name: &str| (name == "ROS_MASTER_URI").then(|| "http://127.0.0.1:1".to_owned());
        let config = NodeConfig::on_this_machine("/gdp_proxy_test", variable);
        Self { main: Node::start(config.clone()).await.unwrap(), publishers: Publishers::new(config) }
    }

    async fn publish(&self, topic: &str, latch: bool) -> Arc<GraphPublisher> {
        self.publishers.publish(&self.main, topic, kind(), options(latch)).await.unwrap()
    }
}

fn options(latch: bool) -> PublishOptions {
    PublishOptions { latch, ..PublishOptions::default() }
}

fn kind() -> MessageType {
    MessageType { name: "std_msgs/String".into(), md5sum: "0".into(), definition: String::new() }
}
