//! Topics that every robot has, such as `/tf` and `/rosout`: what crosses unasked, and how those of
//! several robots merge.

use gdp_tests::dds_domain::lease;
use std::collections::BTreeSet;
use std::time::Instant;

use bytes::Bytes;
use gdp_proxy::ros2::{Domain, RawSample, RawWriter, TypeName};
use serde_json::Value;

use crate::lives::{domain, topic};
use crate::peer::{Peer, Vendor};
use crate::site::Site;
use crate::{LATCHED, RELIABLE, TIMEOUT, within};

/// What the proxies carry if a wide pattern selects everything.
const UNASKED: [&str; 4] = ["/chatter", "/diagnostics", "/tf", "/tf_static"];

#[tokio::test(flavor = "multi_thread")]
async fn a_wide_pattern_leaves_the_time_logs_and_parameters_of_a_robot_at_home() {
    let site = Site::start().await;
    let near = lease();
    let (expose, _) = site.by_pattern("robot", "cloud", "topics: [/**]", "topics: [/**]");
    let _robot = Robot::start(near, "/driver").await;
    let _proxy = site.begin("robot", &domain(near), &expose);
    super::until("the topics are carried", || site.carried("robot").len() >= UNASKED.len()).await;
    // A node is found with all its endpoints at once.
    assert_eq!(site.carried("robot").into_iter().collect::<BTreeSet<_>>(), UNASKED.map(String::from).into());
}

#[tokio::test(flavor = "multi_thread")]
async fn topics_of_two_robots_merge_and_their_clocks_stay_apart() {
    let site = Site::start().await;
    let far = lease();
    let (mut robots, mut imports) = (vec![], vec![]);
    for robot in ["robot1", "robot2"] {
        let near = lease();
        let named = "/rosout, /clock, /parameter_events";
        let (expose, import) = site.by_pattern(
            robot,
            "cloud",
            &format!("topics: [/**, {named}]"),
            &format!("topics: [/**, {named}], prefix: /{robot}, merge: [/tf*, /diagnostics, /rosout]"),
        );
        robots.push((Robot::start(near, &format!("/{robot}_driver")).await, site.begin(robot, &domain(near), &expose)));
        let entry = import.trim().strip_prefix("import: [").and_then(|rest| rest.strip_suffix(']'));
        imports.push(entry.expect("a list of one").to_owned());
    }
    let _cloud = site.begin("cloud", &domain(far), &format!("import: [{}]\n", imports.join(", ")));
    let mut graph = Peer::graph(far, None);
    let publishers = |graph: &Value, topic: &str| graph["topics"][topic].as_array().map_or(0, Vec::len);
    let (mut merged, deadline) = (Value::Null, Instant::now() + TIMEOUT);
    let is_whole = |graph: &Value| {
        let both = ["/tf", "/tf_static", "/diagnostics", "/rosout"];
        let apart = ["/robot1/clock", "/robot2/clock", "/robot1/parameter_events", "/robot2/parameter_events"];
        both.iter().all(|topic| publishers(graph, topic) >= 2)
            && apart.iter().all(|topic| publishers(graph, topic) >= 1)
    };
    while !is_whole(&merged) {
        assert!(Instant::now() < deadline, "{merged:#}\n{}", site.log("cloud"));
        merged = graph.event("graph").await;
    }
    assert_eq!(publishers(&merged, "/clock"), 0, "two robots would set the time of the same nodes: {merged}");
    assert_eq!(publishers(&merged, "/tf"), 2, "{merged}");

    // What the robots log comes too, although it was logged before.
    let cloud = Domain::join(far, "cloud").unwrap();
    let kind = TypeName::parse("rcl_interfaces/msg/Log").unwrap();
    let log = cloud.reader(&topic("/rosout"), &kind, &LATCHED).unwrap();
    let mut missing = BTreeSet::from(["/robot1_driver is ready", "/robot2_driver is ready"]);
    while !missing.is_empty() {
        let line = within("a line of each robot", log.recv()).await.unwrap().sample.bytes;
        missing.retain(|text| !line.windows(text.len()).any(|bytes| bytes == text.as_bytes()));
    }
    cloud.leave().await;
}

/// The nodes of a robot.
struct Robot {
    /// Publishes `/rosout` and `/parameter_events`, as every node.
    _driver: Peer,
    _writers: Vec<RawWriter>,
    _domain: Domain,
}

impl Robot {
    async fn start(id: u16, driver: &str) -> Self {
        let domain = Domain::join(id, "robot").unwrap();
        let mut writers = Vec::new();
        for (name, kind, offers) in [
            ("/tf", "tf2_msgs/msg/TFMessage", RELIABLE),
            ("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED),
            ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", RELIABLE),
            ("/clock", "rosgraph_msgs/msg/Clock", RELIABLE),
        ] {
            let mut writer = domain.writer(&topic(name), &TypeName::parse(kind).unwrap(), &offers).unwrap();
            // Zeros are a message of each of these types.
            writer
                .write(RawSample::parse(Bytes::from([&[0, 1, 0, 0][..], &[0; 16]].concat())).unwrap(), 0)
                .await
                .unwrap();
            writers.push(writer);
        }
        let mut driver = Peer::topic(Vendor::Rclpy, "talk", id, &["--node", driver, "--rate", "5"]);
        driver.event("ready").await;
        Self { _driver: driver, _writers: writers, _domain: domain }
    }
}
