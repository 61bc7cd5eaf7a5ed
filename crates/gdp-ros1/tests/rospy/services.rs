//! Services of rospy called by us, and ours called by rospy.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use gdp_ros1::{CallError, ServiceInfo, ServiceType};
use tokio::sync::Notify;
use tokio::time::sleep;

use crate::harness::{LIMIT, Master, registered, string, until};

const MD5: &str = "09fb03525b03e7ea1fd3992bafd87e16";

fn set_bool() -> ServiceType {
    ServiceType { name: "std_srvs/SetBool".to_owned(), md5sum: MD5.to_owned() }
}

/// A `std_srvs/SetBool` response.
fn response(success: bool, message: &str) -> Bytes {
    [&[u8::from(success)][..], &string(message)].concat().into()
}

#[tokio::test]
async fn services_of_rospy_are_called_without_knowing_their_type() {
    let master = Master::start().await;
    let node = master.node("/ns/bridge").await;
    let client = node.client("/light").unwrap();
    let unserved = client.probe(LIMIT).await;
    assert!(matches!(&unserved, Err(CallError::NoServer { service }) if service == "/light"), "{unserved:?}");
    let (mut light, _) = master.peer("light", &["serve", "/light"]).await;
    let info = ServiceInfo { kind: set_bool().name, md5sum: MD5.to_owned(), caller_id: "/light".to_owned() };
    assert_eq!(client.probe(LIMIT).await.unwrap(), info);
    for md5sum in ["*", MD5] {
        assert_eq!(client.call(md5sum, Bytes::from_static(&[1]), LIMIT).await.unwrap(), response(true, "it is on"));
    }
    let failed = client.call("*", Bytes::from_static(&[0]), LIMIT).await;
    assert!(matches!(&failed, Err(CallError::Failed { text, .. }) if text.contains("it stays on")), "{failed:?}");
    let other = client.call("0123456789abcdef0123456789abcdef", Bytes::new(), LIMIT).await;
    assert!(
        matches!(&other, Err(CallError::Connection { source, .. }) if source.to_string().contains("md5")),
        "{other:?}"
    );
    // Dead without a word: the master still names it, and the call fails at once and says what was
    // tried.
    light.kill();
    let dead = client.call("*", Bytes::from_static(&[1]), LIMIT).await;
    assert!(matches!(&dead, Err(CallError::Connection { uri, .. }) if uri.starts_with("rosrpc://")), "{dead:?}");
}

#[tokio::test]
async fn services_of_ours_are_called_by_rospy() {
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let server = node
        .serve("light", set_bool(), 1, async |request| match request.data[..] {
            [1] => Ok(response(true, &format!("on for {}", request.caller_id))),
            _ => Err("it stays on".to_owned()),
        })
        .unwrap();
    assert_eq!(server.service(), "/light");
    assert!(node.serve("/light", set_bool(), 1, async |_| Ok(Bytes::new())).is_err());
    registered(&node).await;
    let mut once = master.begin("once", &["call", "/light", "true"]);
    // Over one connection: an error does not end it.
    let mut often = master.begin("often", &["call", "/light", "true,false,true"]);
    assert_eq!(once.event("response").await["message"], "on for /once");
    assert_eq!(often.event("response").await["message"], "on for /often");
    let error = often.event("error").await;
    assert!(error["text"].as_str().unwrap().contains("it stays on"), "{error}");
    assert_eq!(often.event("response").await["success"], true);
    // It is gone for callers when its handle is.
    drop(server);
    registered(&node).await;
    let client = node.client("/light").unwrap();
    assert!(matches!(client.probe(LIMIT).await, Err(CallError::NoServer { .. })));
}

#[tokio::test]
async fn who_is_being_answered_gets_that_from_a_node_that_leaves() {
    let master = Master::start().await;
    let (node, other) = (master.node("/bridge").await, master.node("/caller").await);
    let begun = Arc::new(Notify::new());
    let beginning = begun.clone();
    let server = node.serve("/light", set_bool(), 1, move |_| {
        let begun = beginning.clone();
        async move {
            begun.notify_one();
            // To leave takes less.
            sleep(Duration::from_millis(100)).await;
            Err("it goes dark".to_owned())
        }
    });
    registered(&node).await;
    let client = other.client("/light").unwrap();
    let calling = tokio::spawn(async move { client.call("*", Bytes::from_static(&[1]), LIMIT).await });
    begun.notified().await;
    drop(server);
    node.leave().await;
    let failed = calling.await.unwrap();
    assert!(matches!(&failed, Err(CallError::Failed { text, .. }) if text == "it goes dark"), "{failed:?}");
}

#[tokio::test]
async fn slow_services_take_so_many_calls_at_once_and_calls_have_an_end() {
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let running = Arc::new(Running::default());
    let counted = running.clone();
    let _server = node.serve("/slow", set_bool(), 2, move |request| {
        let counted = counted.clone();
        async move {
            let _one = One::of(&counted);
            match request.data.is_empty() {
                true => std::future::pending().await,
                false => sleep(Duration::from_millis(100)).await,
            }
            Ok(response(true, ""))
        }
    });
    registered(&node).await;
    let client = node.client("/slow").unwrap();
    let calls: Vec<_> = (0..6)
        .map(|_| {
            let client = client.clone();
            tokio::spawn(async move { client.call("*", Bytes::from_static(&[1]), LIMIT).await })
        })
        .collect();
    for call in calls {
        assert_eq!(call.await.unwrap().unwrap(), response(true, ""));
    }
    assert_eq!(running.most.load(Ordering::SeqCst), 2);
    let late = client.call("*", Bytes::new(), Duration::from_millis(300)).await;
    assert!(matches!(late, Err(CallError::Timeout { .. })), "{late:?}");
    // Who has hung up is not worked for any longer.
    until("the call ends at the server", async || (running.now.load(Ordering::SeqCst) == 0).then_some(())).await;
}

/// Calls that are being answered.
#[derive(Default)]
struct Running {
    now: AtomicUsize,
    most: AtomicUsize,
}

struct One(Arc<Running>);

impl One {
    fn of(running: &Arc<Running>) -> Self {
        running.most.fetch_max(running.now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
        Self(running.clone())
    }
}

impl Drop for One {
    fn drop(&mut self) {
        self.0.now.fetch_sub(1, Ordering::SeqCst);
    }
}
