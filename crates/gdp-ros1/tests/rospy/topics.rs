//! Topics from and to rospy.

use bytes::Bytes;
use gdp_ros1::{MessageType, PublishOptions, SourceState, SubscribeOptions, Subscription};
use tokio::time::timeout;

use crate::harness::{LIMIT, Master, next_text, registered, string, string_type, until};

const IMAGE_MD5: &str = "060021388200f6f0f447d0fcd9c64743";

const LATCHED: PublishOptions =
    PublishOptions { latch: true, queue: gdp_ros1::QueueLimits { messages: 10, bytes: 128 << 20 } };

#[tokio::test]
async fn what_rospy_publishes_comes_with_all_that_is_known_of_it() {
    let master = Master::start().await;
    let (_talker, _) = master.peer("talker", &["latch", "/chatter", "hello"]).await;
    let node = master.node("/ns/bridge").await;
    for _ in 0..2 {
        // Late both times: the latched message comes to each subscription.
        let mut subscription = node.subscribe("/chatter", SubscribeOptions::default()).unwrap();
        let message = timeout(LIMIT, subscription.next()).await.unwrap().unwrap();
        assert_eq!(message.data, string("hello"));
        let publisher = &message.publisher;
        assert_eq!((publisher.caller_id.as_str(), publisher.latching), ("/talker", true));
        assert_eq!((publisher.kind.as_str(), &publisher.md5sum), ("std_msgs/String", &string_type().md5sum));
        assert_eq!(publisher.definition.trim(), "string data");
    }
    // A wrong type is said, and not taken.
    let kind = Some(("std_msgs/Int32".to_owned(), "da5909fbe378aeaf85e547e830cc1bb7".to_owned()));
    let subscription = node.subscribe("/chatter", SubscribeOptions { kind, ..SubscribeOptions::default() }).unwrap();
    until("the type is refused", async || {
        let says_why =
            |state: &SourceState| matches!(state, SourceState::Failed(why) if why.contains("std_msgs/Int32"));
        subscription.sources().borrow().values().any(says_why).then_some(())
    })
    .await;
}

#[tokio::test]
async fn what_is_published_comes_to_rospy_and_to_who_joins_late() {
    let master = Master::start().await;
    let (mut early, _) = master.peer("early", &["listen", "/ns/chatter"]).await;
    let node = master.node("/ns/bridge").await;
    let publisher = node.publish("chatter", string_type(), LATCHED).unwrap();
    assert_eq!(publisher.topic(), "/ns/chatter");
    until("rospy connects", async || (!publisher.subscribers().is_empty()).then_some(())).await;
    for i in 0..5 {
        publisher.publish(string(&format!("message {i}"))).unwrap();
    }
    for i in 0..5 {
        let heard = early.event("message").await;
        assert_eq!(heard["data"], format!("message {i}"));
        assert_eq!(heard["caller"], "/ns/bridge");
    }
    for name in ["late", "later"] {
        let (mut late, _) = master.peer(name, &["listen", "/ns/chatter"]).await;
        assert_eq!(late.event("message").await["data"], "message 4");
        let name = format!("/{name}");
        assert!(publisher.subscribers().iter().any(|subscriber| subscriber.caller_id == name));
        late.stop().await;
        until("it is gone", async || (publisher.subscribers().len() == 1).then_some(())).await;
    }
    assert_eq!(publisher.dropped(), 0);
    // Another of the same topic only after this one; then rospy goes over to it.
    assert!(node.publish("/ns/chatter", string_type(), LATCHED).is_err());
    drop(publisher);
    let publisher = node.publish("/ns/chatter", string_type(), LATCHED).unwrap();
    publisher.publish(string("again")).unwrap();
    assert_eq!(early.event("message").await["data"], "again");
}

#[tokio::test]
async fn several_publishers_of_a_topic_come_and_go() {
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let mut subscription = node.subscribe("/chatter", SubscribeOptions::default()).unwrap();
    let (mut one, _) = master.peer("one", &["publish", "/chatter", "from one"]).await;
    let (mut two, _) = master.peer("two", &["publish", "/chatter", "from two"]).await;
    hear(&mut subscription, "/one", "from one").await;
    hear(&mut subscription, "/two", "from two").await;
    assert_eq!(connected(&subscription), ["/one", "/two"]);
    // One takes leave, the other dies. The master goes on listing the dead one; we go on trying,
    // and everybody else is heard.
    one.stop().await;
    two.kill();
    until("both are missed", async || connected(&subscription).is_empty().then_some(())).await;
    let (_three, _) = master.peer("three", &["publish", "/chatter", "from three"]).await;
    hear(&mut subscription, "/three", "from three").await;
    let (_two, _) = master.peer("two", &["publish", "/chatter", "from two again"]).await;
    hear(&mut subscription, "/two", "from two again").await;
    until("the dead one's address is forgotten", async || (subscription.sources().borrow().len() == 2).then_some(()))
        .await;
}

#[tokio::test]
async fn ten_megabytes_go_both_ways() {
    const SIZE: usize = 10 << 20;
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let mut subscription = node.subscribe("/camera", SubscribeOptions::default()).unwrap();
    let (_camera, said) = master.peer("camera", &["publish-image", "/camera", &SIZE.to_string()]).await;
    let message = timeout(LIMIT, subscription.next()).await.unwrap().unwrap();
    assert_eq!((message.publisher.kind.as_str(), message.publisher.md5sum.as_str()), ("sensor_msgs/Image", IMAGE_MD5));
    assert!(message.publisher.definition.contains("MSG: std_msgs/Header"));
    // The same bytes, published again by us, are the same image to rospy.
    let kind = MessageType {
        name: message.publisher.kind.clone(),
        md5sum: message.publisher.md5sum.clone(),
        definition: message.publisher.definition.clone(),
    };
    let publisher = node.publish("/again", kind, LATCHED).unwrap();
    publisher.publish(message.data.clone()).unwrap();
    let (mut viewer, _) = master.peer("viewer", &["listen-image", "/again"]).await;
    let heard = viewer.event("message").await;
    assert_eq!(
        (&heard["sha256"], heard["size"].as_u64(), heard["frame"].as_str()),
        (&said["sha256"], Some(SIZE as u64), Some("camera"))
    );
    let max = master.config("/x").max_message;
    assert!(publisher.publish(Bytes::from(vec![0; max + 1])).is_err());
}

#[tokio::test]
async fn what_the_node_publishes_itself_does_not_come_back() {
    let master = Master::start().await;
    let (node, other) = (master.node("/bridge").await, master.node("/other").await);
    let own = node.publish("/chatter", string_type(), LATCHED).unwrap();
    let mut subscription = node.subscribe("/chatter", SubscribeOptions::default()).unwrap();
    own.publish(string("own")).unwrap();
    registered(&node).await;
    let foreign = other.publish("/chatter", string_type(), LATCHED).unwrap();
    foreign.publish(string("foreign")).unwrap();
    // It came after ours, which would have been there first.
    assert_eq!(next_text(&mut subscription).await, ("foreign".to_owned(), "/other".to_owned()));
    let mut heard = other.subscribe("/chatter", SubscribeOptions::default()).unwrap();
    assert_eq!(next_text(&mut heard).await, ("own".to_owned(), "/bridge".to_owned()));
    assert_eq!(connected(&subscription), ["/other"]);
}

/// Waits for a message with this beginning from this node.
async fn hear(subscription: &mut Subscription, from: &str, text: &str) {
    let heard = async {
        loop {
            let (heard, caller_id) = next_text(subscription).await;
            if caller_id == from && heard.starts_with(text) {
                return;
            }
        }
    };
    timeout(LIMIT, heard).await.unwrap_or_else(|_| panic!("nothing from {from}"));
}

/// The nodes that a subscription is connected to, sorted.
fn connected(subscription: &Subscription) -> Vec<String> {
    let sources = subscription.sources();
    let name = |state: &SourceState| match state {
        SourceState::Connected(publisher) => Some(publisher.caller_id.clone()),
        _ => None,
    };
    let mut names: Vec<String> = sources.borrow().values().filter_map(name).collect();
    names.sort();
    names
}
