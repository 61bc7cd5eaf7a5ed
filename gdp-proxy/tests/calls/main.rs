//! Services and actions of real rclpy and rospy nodes, through proxies and a switch: on loopback
//! and without root.
//!
//! ```text
//!    rclpy, rospy ── proxy ── switch, RIB ── proxy ── rclpy, rospy
//! ```

mod actionlib;
#[path = "../hub/mod.rs"]
mod hub;
#[allow(dead_code, reason = "the tests of the ROS 1 node, whose it is, use the rest")]
#[path = "../../../crates/gdp-ros1/tests/rospy/master.rs"]
mod master;
mod patterns;
mod replicas;
mod ros2;
#[allow(dead_code, reason = "the tests of topics, whose it is, use the rest")]
#[path = "../bridge/site.rs"]
mod site;
mod turns;

use master::Master;
use ros2::Ros2;
use site::Site;

const OUT: &str = "direction: out";
const IN: &str = "direction: in";
const FIBONACCI: &str = "test_msgs/action/Fibonacci";

#[tokio::test(flavor = "multi_thread")]
async fn a_service_is_there_while_its_server_lives() {
    let site = Site::start().await;
    let (robot, cloud) = (Ros2::new(), Ros2::new());
    // No type: both proxies learn it.
    let services = [site.name("service", "/add", "")];
    let _out = site.proxy("robot", &robot.graph(), &services, OUT);
    let _in = site.proxy("cloud", &cloud.graph(), &services, IN);
    let mut watch = cloud.begin("watch", &["watch", "/add"]);
    watch.event("gone").await;
    let mut server = robot.peer("adder", &["serve", "/add"]).await;
    watch.event("there").await;
    let mut client = cloud.begin("client", &["call", "/add", "40", "2", "5"]);
    for sum in 42..47 {
        let response = client.event("response").await;
        assert_eq!((&response["sum"], &response["server"]), (&sum.into(), &"adder".into()));
    }
    server.stop().await;
    watch.event("gone").await;
    let _server = robot.peer("again", &["serve", "/add"]).await;
    watch.event("there").await;
    let response = cloud.begin("another", &["call", "/add", "1", "2"]).event("response").await;
    assert_eq!((&response["sum"], &response["server"]), (&3.into(), &"again".into()));
}

#[tokio::test(flavor = "multi_thread")]
async fn ros_1_calls_ros_2_and_hears_at_once_that_a_server_has_gone() {
    let site = Site::start().await;
    let (robot, master) = (Ros2::new(), Master::start().await);
    let services = [site.name("service", "/light", "std_srvs/srv/SetBool")];
    let _out = site.proxy("robot", &robot.graph(), &services, OUT);
    let _in = site.proxy("cloud", &graph(&master), &services, IN);
    let mut light = robot.peer("light", &["switch", "/light"]).await;
    let mut client = master.begin("client", &["call", "/light", "true,false"]);
    let response = client.event("response").await;
    assert_eq!((&response["success"], &response["message"]), (&true.into(), &"it is on".into()));
    light.event("set").await;
    assert_eq!(light.event("set").await["data"], false);
    // It does not answer, and then it goes.
    light.stop().await;
    let error = client.event("error").await;
    assert!(
        error["text"].as_str().unwrap().contains("has gone") || error["text"].as_str().unwrap().contains("left"),
        "{error}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn ros_2_calls_ros_1() {
    let site = Site::start().await;
    let (master, cloud) = (Master::start().await, Ros2::new());
    let services = [site.name("service", "/lamp", "std_srvs/srv/SetBool")];
    let _out = site.proxy("robot", &graph(&master), &services, OUT);
    let _in = site.proxy("cloud", &cloud.graph(), &services, IN);
    let (_lamp, _) = master.peer("lamp", &["serve", "/lamp"]).await;
    let response = cloud.begin("client", &["set", "/lamp", "true"]).event("response").await;
    assert_eq!((&response["success"], &response["message"]), (&true.into(), &"it is on".into()));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_action_gives_feedback_is_cancelled_and_takes_its_time() {
    let site = Site::start().await;
    let (robot, cloud) = (Ros2::new(), Ros2::new());
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    let _out = site.proxy("robot", &robot.graph(), &actions, OUT);
    let _in = site.proxy("cloud", &cloud.graph(), &actions, IN);
    let mut server = robot.peer("server", &["compute", "/fibonacci", "0.25"]).await;
    // Longer than anything on the way waits for anything.
    let mut patient = cloud.begin("patient", &["send", "/fibonacci", "50"]);
    patient.event("accepted").await;
    // What comes first may come before ROS has discovered who hears it, as of a server beside the
    // client.
    let first = patient.event("feedback").await["length"].as_u64().unwrap();
    assert!((3..20).contains(&first), "{first}");
    for length in first + 1..first + 5 {
        assert_eq!(patient.event("feedback").await["length"], length, "each, in order");
    }
    let mut hasty = cloud.begin("hasty", &["send", "/fibonacci", "1000", "3"]);
    let first = hasty.event("feedback").await["length"].as_u64().unwrap();
    assert!((3..8).contains(&first), "of its own goal alone: {first}");
    assert_eq!(hasty.event("canceling").await["goals"], 1);
    let result = hasty.event("result").await;
    assert_eq!((&result["status"], &result["shown"]), (&"canceled".into(), &"canceled".into()));
    server.event("canceled").await;
    assert_eq!(patient.event("feedback").await["length"].as_u64().map(|length| length > 7), Some(true));
    let result = patient.event("result").await;
    assert_eq!((&result["status"], &result["length"]), (&"succeeded".into(), &50.into()));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_stays_with_its_server_and_ends_with_it() {
    let site = Site::start().await;
    let (robots, cloud) = ([Ros2::new(), Ros2::new()], Ros2::new());
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    let _out = [("one", &robots[0]), ("two", &robots[1])]
        .map(|(label, robot)| site.proxy(label, &robot.graph(), &actions, OUT));
    let _in = site.proxy("cloud", &cloud.graph(), &actions, IN);
    let mut servers = [
        robots[0].peer("server", &["compute", "/fibonacci", "0.1"]).await,
        robots[1].peer("server", &["compute", "/fibonacci", "0.1"]).await,
    ];
    let mut first = cloud.begin("first", &["send", "/fibonacci", "10000"]);
    first.event("accepted").await;
    first.event("feedback").await;
    let [one, two] = &mut servers;
    let (has_it, other) = tokio::select! {
        _ = one.event("goal") => (0, 1),
        _ = two.event("goal") => (1, 0),
    };
    // It goes; the goal is lost, and says so.
    servers[has_it].stop().await;
    let result = first.event("result").await;
    assert_eq!(
        (&result["status"], &result["shown"], &result["length"]),
        (&"aborted".into(), &"aborted".into(), &0.into())
    );
    // The other may have been found only now.
    let mut second = cloud.begin("second", &["send", "/fibonacci", "5"]);
    assert_eq!(second.event("result").await["status"], "succeeded");
    assert_eq!(servers[other].event("goal").await["order"], 5);
}

/// A master, as a configuration says it.
fn graph(master: &Master) -> String {
    let config = master.config("/unused");
    format!("{{master: '{}', host: {}}}", config.master_uri, config.host)
}
