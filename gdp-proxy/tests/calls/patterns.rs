//! Services and actions that cross by pattern.

use crate::graph;
use crate::master::{Master, until};
use crate::ros2::Ros2;
use crate::site::{Proxy, Site};

#[tokio::test(flavor = "multi_thread")]
async fn what_matches_is_called_from_elsewhere_while_it_is_served_and_never_comes_back() {
    let site = Site::start().await;
    let (robot, cloud) = (Ros2::new(), Ros2::new());
    let patterns = "services: [/**], actions: [/**]";
    let says = |more: &str| format!("{patterns}, {more}");
    let (out, far) = site.by_pattern(
        "robot",
        "cloud",
        &says("deny: [/secret], remap: [{from: /add, to: /sum}]"),
        &says("prefix: /far"),
    );
    let (back_out, back) = site.by_pattern("cloud", "robot", patterns, &says("prefix: /back"));
    let robots = site.begin("robot", &robot.graph(), &format!("{out}{back}"));
    let clouds = site.begin("cloud", &cloud.graph(), &format!("{back_out}{far}"));

    let mut watch = cloud.begin("watch", &["watch", "/far/sum"]);
    watch.event("gone").await;
    let _secret = robot.peer("secret", &["serve", "/secret"]).await;
    let _server = robot.peer("server", &["compute", "/fibonacci", "0.1"]).await;
    let mut adder = robot.peer("adder", &["serve", "/add"]).await;
    watch.event("there").await;
    let response = cloud.begin("client", &["call", "/far/sum", "40", "2"]).event("response").await;
    assert_eq!((&response["sum"], &response["server"]), (&42.into(), &"adder".into()));
    let mut sender = cloud.begin("sender", &["send", "/far/fibonacci", "10"]);
    sender.event("feedback").await;
    assert_eq!(sender.event("result").await["status"], "succeeded");
    // Neither what is denied, nor what every node serves, nor what has come by the fabric.
    let with =
        (vec!["out service /add", "out action /fibonacci"], vec!["in service /far/sum", "in action /far/fibonacci"]);
    assert_eq!((shown(&robots), shown(&clouds)), (sorted(with.0.clone()), sorted(with.1.clone())));

    adder.stop().await;
    watch.event("gone").await;
    let without = (vec!["out action /fibonacci"], vec!["in action /far/fibonacci"]);
    until("it is listed no more", async || (shown(&robots) == without.0 && shown(&clouds) == without.1).then_some(()))
        .await;
    let _adder = robot.peer("again", &["serve", "/add"]).await;
    watch.event("there").await;
    let response = cloud.begin("another", &["call", "/far/sum", "1", "2"]).event("response").await;
    assert_eq!((&response["sum"], &response["server"]), (&3.into(), &"again".into()));
    assert_eq!((shown(&robots), shown(&clouds)), (sorted(with.0), sorted(with.1)));

    // Both would carry out each call.
    let _local = cloud.peer("local", &["serve", "/far/sum"]).await;
    until("the server here goes first", async || {
        (shown(&clouds) == ["in action /far/fibonacci", "out service /far/sum"]).then_some(())
    })
    .await;
    let response = cloud.begin("third", &["call", "/far/sum", "2", "2"]).event("response").await;
    assert_eq!(response["server"], "local");
}

/// Its master does not know the types of services.
#[tokio::test(flavor = "multi_thread")]
async fn a_service_of_ros_1_is_called_from_ros_2_by_pattern() {
    let site = Site::start().await;
    let (master, cloud) = (Master::start().await, Ros2::new());
    let (out, far) = site.by_pattern("robot", "cloud", "services: [/**]", "services: [/**], prefix: /far");
    let robots = site.begin("robot", &graph(&master), &out);
    let clouds = site.begin("cloud", &cloud.graph(), &far);
    let (mut lamp, _) = master.peer("light", &["serve", "/lamp"]).await;
    let response = cloud.begin("client", &["set", "/far/lamp", "true"]).event("response").await;
    assert_eq!((&response["success"], &response["message"]), (&true.into(), &"it is on".into()));
    assert_eq!(
        (shown(&robots), shown(&clouds)),
        (vec!["out service /lamp".into()], vec!["in service /far/lamp".into()])
    );
    lamp.stop().await;
    until("it is listed no more", async || (shown(&robots).is_empty() && shown(&clouds).is_empty()).then_some(()))
        .await;
}

/// What a proxy carries, sorted: `out service /add`.
fn shown(proxy: &Proxy) -> Vec<String> {
    let calls = proxy.calls().into_iter().map(|call| {
        let text = |key: &str| call[key].as_str().unwrap().to_owned();
        format!("{} {} {}", text("direction"), text("what"), text("service"))
    });
    sorted(calls.collect())
}

fn sorted<T: Into<String>>(texts: Vec<T>) -> Vec<String> {
    let mut texts: Vec<String> = texts.into_iter().map(Into::into).collect();
    texts.sort();
    texts
}
