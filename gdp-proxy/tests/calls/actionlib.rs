//! Actions between the ROS versions: clients and servers of actionlib and of rclpy.
//!
//! ```text
//!    actionlib or rclpy server ── proxy ── switch ── proxy ── actionlib or rclpy clients
//! ```

use std::fs;
use std::time::Duration;

use gdp_tests::programs::own;

use crate::master::{Master, Process, until};
use crate::ros2::{Ros2, target};
use crate::site::{Proxy, Site, Topic};
use crate::{FIBONACCI, IN, OUT, graph};

/// The definition of the action, which no proxy has by itself.
const DEFINITION: &str = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n";

/// What actionlib's `GoalStatus` calls them.
const PREEMPTED: u64 = 2;
const SUCCEEDED: u64 = 3;
const ABORTED: u64 = 4;
const REJECTED: u64 = 5;

#[tokio::test(flavor = "multi_thread")]
async fn a_client_of_ros_2_has_its_server_in_ros_1() {
    let site = Site::start().await;
    let (robot, cloud) = (Master::start().await, Ros2::new());
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    let _out = knowing(&site, "ros1", "robot", &graph(&robot), &actions, OUT);
    let _in = site.proxy("cloud", &cloud.graph(), &actions, IN);
    let (mut server, _) = robot.peer("server", &["compute", "/fibonacci", "test_msgs", "0.25"]).await;
    let mut patient = cloud.begin("patient", &["send", "/fibonacci", "30"]);
    patient.event("accepted").await;
    let first = length(&mut patient).await;
    for next in first + 1..first + 5 {
        assert_eq!(length(&mut patient).await, next, "each, in order");
    }
    let mut hasty = cloud.begin("hasty", &["send", "/fibonacci", "1000", "3"]);
    assert_eq!(hasty.event("canceling").await["goals"], 1);
    let result = hasty.event("result").await;
    assert_eq!((&result["status"], &result["shown"]), (&"canceled".into(), &"canceled".into()));
    assert!(result["length"].as_u64().unwrap() > 3, "what there was so far: {result}");
    server.event("canceled").await;
    cloud.begin("wrong", &["send", "/fibonacci", "-1"]).event("rejected").await;
    let result = patient.event("result").await;
    assert_eq!((&result["status"], &result["shown"]), (&"succeeded".into(), &"succeeded".into()));
    assert_eq!(result["length"], 30);

    // It goes without a word, and another one comes in its place.
    let mut unlucky = cloud.begin("unlucky", &["send", "/fibonacci", "1000"]);
    unlucky.event("feedback").await;
    server.kill();
    assert_eq!(unlucky.event("result").await["status"], "aborted");
    let (_server, _) = robot.peer("server", &["compute", "/fibonacci", "test_msgs", "0.1"]).await;
    // A goal to the server that is just going has no answer, as in ROS 2 alone.
    let mut answer = None;
    for attempt in 0..5 {
        let mut lucky = cloud.begin(&format!("lucky_{attempt}"), &["send", "/fibonacci", "5"]);
        answer = tokio::time::timeout(Duration::from_secs(10), lucky.event("result")).await.ok();
        if answer.is_some() {
            break;
        }
    }
    let result = answer.expect("an answer of the server in its place");
    assert_eq!((&result["status"], &result["length"]), (&"succeeded".into(), &5.into()));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_of_ros_1_has_its_server_in_ros_2() {
    let site = Site::start().await;
    let (robot, cloud) = (Ros2::new(), Master::start().await);
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    // The other proxy learns the definition from this one.
    let _out = knowing(&site, "ros2", "robot", &robot.graph(), &actions, OUT);
    let proxy = site.proxy("cloud", &graph(&cloud), &actions, IN);
    let mut server = robot.peer("server", &["compute", "/fibonacci", "0.25"]).await;
    let send =
        |name: &str, rest: &[&str]| cloud.begin(name, &[&["send", "/fibonacci", "test_msgs"][..], rest].concat());
    let mut patient = send("patient", &["30"]);
    assert_eq!(patient.event("server").await["found"], true);
    let first = length(&mut patient).await;
    for next in first + 1..first + 5 {
        assert_eq!(length(&mut patient).await, next, "each, in order");
    }
    let mut hasty = send("hasty", &["1000", "3"]);
    let result = hasty.event("result").await;
    assert_eq!((&result["finished"], &result["state"]), (&true.into(), &PREEMPTED.into()), "{result}");
    assert!(result["length"].as_u64().unwrap() > 3, "what there was so far: {result}");
    server.event("canceled").await;
    let result = send("wrong", &["-1"]).event("result").await;
    assert_eq!((&result["state"], &result["text"]), (&REJECTED.into(), &"the server has rejected it".into()));
    let result = patient.event("result").await;
    assert_eq!((&result["state"], &result["length"]), (&SUCCEEDED.into(), &30.into()), "{result}");
    for how in ["all", "before"] {
        let result = send(how, &["1000", "2", how]).event("result").await;
        assert_eq!(result["state"], PREEMPTED, "{how}: {result}");
        server.event("canceled").await;
    }

    let mut unlucky = send("unlucky", &["1000"]);
    unlucky.event("feedback").await;
    server.stop().await;
    let result = unlucky.event("result").await;
    assert_eq!((&result["finished"], &result["state"]), (&true.into(), &ABORTED.into()), "{result}");
    let _server = robot.peer("server", &["compute", "/fibonacci", "0.1"]).await;
    let result = send("lucky", &["5"]).event("result").await;
    assert_eq!((&result["state"], &result["length"]), (&SUCCEEDED.into(), &5.into()), "{result}");

    let mut last = send("last", &["1000"]);
    last.event("feedback").await;
    proxy.stop();
    let result = last.event("result").await;
    assert_eq!((&result["finished"], &result["state"]), (&true.into(), &ABORTED.into()), "{result}");
}

/// The same with applications in C++, whose server executes one goal at a time.
#[tokio::test(flavor = "multi_thread")]
async fn a_client_of_ros_2_has_its_server_in_roscpp_which_prefers_the_later_goal() {
    let site = Site::start().await;
    let (robot, cloud) = (Master::start().await, Ros2::new());
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    let _out = knowing(&site, "ros1", "robot", &graph(&robot), &actions, OUT);
    let _in = site.proxy("cloud", &cloud.graph(), &actions, IN);
    let mut server = roscpp(&robot, "server", &["compute", "/fibonacci", "0.25"]);
    server.event("ready").await;
    let mut first = cloud.begin("first", &["send", "/fibonacci", "1000"]);
    first.event("feedback").await;
    let mut second = cloud.begin("second", &["send", "/fibonacci", "7"]);
    let result = first.event("result").await;
    assert_eq!((&result["status"], &result["shown"]), (&"canceled".into(), &"canceled".into()));
    let result = second.event("result").await;
    assert_eq!((&result["status"], &result["length"]), (&"succeeded".into(), &7.into()));
    let result = cloud.begin("hasty", &["send", "/fibonacci", "1000", "3"]).event("result").await;
    assert_eq!(result["status"], "canceled");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_in_roscpp_has_its_server_in_ros_2() {
    let site = Site::start().await;
    let (robot, cloud) = (Ros2::new(), Master::start().await);
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    let _out = knowing(&site, "ros2", "robot", &robot.graph(), &actions, OUT);
    let _in = site.proxy("cloud", &graph(&cloud), &actions, IN);
    let _server = robot.peer("server", &["compute", "/fibonacci", "0.2"]).await;
    let mut patient = roscpp(&cloud, "patient", &["send", "/fibonacci", "10"]);
    assert_eq!(patient.event("server").await["found"], true);
    let first = length(&mut patient).await;
    for next in first + 1..8 {
        assert_eq!(length(&mut patient).await, next, "each, in order");
    }
    let result = patient.event("result").await;
    assert_eq!((&result["state"], &result["length"]), (&"SUCCEEDED".into(), &10.into()), "{result}");
    let result = roscpp(&cloud, "hasty", &["send", "/fibonacci", "1000", "3"]).event("result").await;
    assert_eq!((&result["finished"], &result["state"]), (&true.into(), &"PREEMPTED".into()), "{result}");
}

/// The same action is also topics, which both sides would carry.
#[tokio::test(flavor = "multi_thread")]
async fn between_two_masters_a_goal_is_executed_once() {
    let site = Site::start().await;
    let (here, there) = (Master::start().await, Master::start().await);
    let everything = "topics: [/**], actions: [/**]";
    let (out, taken) = site.by_pattern("robot", "cloud", everything, everything);
    // Exposes no actions, but takes them.
    let (back, given) = site.by_pattern("cloud", "robot", "topics: [/**]", everything);
    let share = share(&site, "ros1", "robot");
    let _robot = site.begin("robot", &graph(&here), &format!("{out}{given}{share}"));
    let _cloud = site.begin("cloud", &graph(&there), &format!("{back}{taken}"));
    let (mut server, _) = here.peer("server", &["compute", "/fibonacci", "test_msgs", "0.2"]).await;
    let mut client = there.begin("client", &["send", "/fibonacci", "test_msgs", "12"]);
    assert_eq!(client.event("server").await["found"], true);
    let result = client.event("result").await;
    assert_eq!((&result["state"], &result["length"]), (&SUCCEEDED.into(), &12.into()), "{result}");
    let result = there.begin("second", &["send", "/fibonacci", "test_msgs", "5"]).event("result").await;
    assert_eq!((&result["state"], &result["length"]), (&SUCCEEDED.into(), &5.into()), "{result}");
    assert_eq!(server.event("goal").await["order"], 12);
    assert_eq!(server.event("goal").await["order"], 5, "each goal once");
    for label in ["robot", "cloud"] {
        let of_action: Vec<_> = site.carried(label).into_iter().filter(|topic| topic.contains("fibonacci")).collect();
        assert!(of_action.is_empty(), "{label}: {of_action:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_status_says_which_definition_is_missing_or_differs() {
    let site = Site::start().await;
    let robot = Master::start().await;
    let (_server, _) = robot.peer("server", &["compute", "/fibonacci", "test_msgs", "1"]).await;
    let says = async |proxy: &Proxy, text: &str| {
        let status = || Some(proxy.calls().first()?["status"].as_str()?.to_owned());
        until(text, async || status().filter(|status| status.contains(text))).await
    };
    // The master still lists one that was killed.
    let (third, crashed) = (Master::start().await, [site.name("action", "/crashed", FIBONACCI)]);
    let aware = knowing(&site, "ros1", "aware", &graph(&third), &crashed, OUT);
    let (mut victim, _) = third.peer("victim", &["compute", "/crashed", "test_msgs", "1"]).await;
    says(&aware, "up").await;
    victim.kill();
    let unmatched = "does not match the proxy's client";
    says(&aware, unmatched).await;
    let unknown = "there is no definition of test_msgs/action/Fibonacci";
    // Nor does the proxy of a server in ROS 2 know it.
    let (other, cloud) = (Ros2::new(), Master::start().await);
    let elsewhere = [site.name("action", "/elsewhere", FIBONACCI)];
    let _out = site.proxy("other", &other.graph(), &elsewhere, OUT);
    let _server_elsewhere = other.peer("server", &["compute", "/elsewhere", "1"]).await;
    let client = site.proxy("cloud", &graph(&cloud), &elsewhere, IN);
    says(&client, unknown).await;
    let actions = [site.name("action", "/fibonacci", FIBONACCI)];
    let proxy = site.proxy("unaware", &graph(&robot), &actions, OUT);
    says(&proxy, unknown).await;
    // Both ask again by then.
    tokio::time::sleep(Duration::from_secs(6)).await;
    for label in ["unaware", "cloud"] {
        assert_eq!(site.log(label).matches(unknown).count(), 1, "{label}: not again and again");
    }
    drop(proxy);
    assert_eq!(site.log("aware").matches(unmatched).count(), 1, "not again and again");
    says(&aware, unmatched).await;
    let share = share(&site, "ros1", "mistaken");
    let file = site.folder("mistaken").join("share/test_msgs/action/Fibonacci.action");
    fs::write(file, DEFINITION.replace("sequence\n---", "numbers\n---")).unwrap();
    let proxy = site.proxy_of("mistaken", &graph(&robot), &actions, OUT, &share);
    says(&proxy, "test_msgs/FibonacciActionResult has the MD5 sum").await;
}

/// A proxy with the definition of the action.
fn knowing(site: &Site, version: &str, label: &str, graph: &str, actions: &[Topic], says: &str) -> Proxy {
    let share = share(site, version, label);
    site.proxy_of(label, graph, actions, says, &share)
}

/// Writes a share folder with the definition, and returns what the configuration says of it.
fn share(site: &Site, version: &str, label: &str) -> String {
    let folder = site.folder(label).join("share/test_msgs/action");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("Fibonacci.action"), DEFINITION).unwrap();
    format!("definitions: {{{version}: [share]}}\n")
}

/// A node of roscpp.
fn roscpp(master: &Master, name: &str, arguments: &[&str]) -> Process {
    let program = target().join("peers/actionlib-peer");
    assert!(program.is_file(), "{} does not exist: run `cargo xtask test`", program.display());
    let mut command = own(program);
    command.arg(name).args(arguments);
    master.spawn(name, command)
}

async fn length(client: &mut Process) -> u64 {
    client.event("feedback").await["length"].as_u64().unwrap()
}
