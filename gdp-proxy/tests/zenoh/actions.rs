//! Actions between Zenoh and DDS: with a server and a client by eclipse-zenoh, whose types have the
//! hashes of rosidl.

use crate::peer::{Peer, target};
use crate::site::Site;
use crate::{IN, OUT, Router, dds};
use gdp_tests::dds_domain::lease;

const FIBONACCI: &str = "test_msgs/action/Fibonacci";

#[tokio::test(flavor = "multi_thread")]
async fn a_dds_client_sends_a_goal_to_a_zenoh_server() {
    let site = Site::start().await;
    let (router, domain) = (Router::start().await, lease());
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    let _proxies = [site.proxy("a", &router.graph(), &actions, OUT), site.proxy("b", &dds(domain), &actions, IN)];
    let mut server = router.action("compute", &[]);
    let mut client = Peer::rclpy_action(domain, &["client", "send", "/fibonacci", "30"]);
    client.event("accepted").await;
    assert_eq!(server.event("goal").await["order"], 30);
    let first = client.event("feedback").await["length"].as_u64().unwrap();
    assert_eq!(client.event("feedback").await["length"], first + 1, "each, in order");
    let result = client.event("result").await;
    assert_eq!((&result["status"], &result["length"]), (&"succeeded".into(), &30.into()), "{result}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_zenoh_client_sends_a_goal_to_a_dds_server() {
    let site = Site::start().await;
    let (router, domain) = (Router::start().await, lease());
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    // Only the proxy in DDS knows the type, which DDS does not announce.
    let types = format!("definitions: {{ros2: ['{}']}}", target().join("venv/share").display());
    let _proxies =
        [site.proxy_of("a", &dds(domain), &actions, OUT, &types), site.proxy("b", &router.graph(), &actions, IN)];
    let mut server = Peer::rclpy_action(domain, &["server", "compute", "/fibonacci", "0.1"]);
    let mut client = router.action("send", &["--order", "20"]);
    client.event("accepted").await;
    assert_eq!(server.event("goal").await["order"], 20);
    client.event("status").await;
    let first = client.event("feedback").await["length"].as_u64().unwrap();
    assert_eq!(client.event("feedback").await["length"], first + 1, "each, in order");
    let result = client.event("result").await;
    assert_eq!((&result["status"], &result["length"]), (&4.into(), &20.into()), "{result}");
}
