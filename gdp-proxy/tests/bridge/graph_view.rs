//! The graph of far nodes as ROS tools see it, through rclpy's graph interface.

use gdp_tests::dds_domain::lease;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::peer::{Peer, Vendor};
use crate::site::Site;

/// RIHS01 of std_msgs/msg/String, as ROS 2 states it.
const STRING: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

/// The services behind `ros2 param`.
const PARAMETERS: &str = "/**/list_parameters, /**/get_parameters, /**/set_parameters, /**/get_parameter_types, \
                          /**/describe_parameters, /**/set_parameters_atomically";

#[tokio::test(flavor = "multi_thread")]
async fn far_nodes_appear_with_their_endpoints_types_and_parameters() {
    let site = Site::start().await;
    let (near, far) = (lease(), lease());
    let (expose, import) = site.by_pattern(
        "robot",
        "cloud",
        &format!("topics: [/camera/**], services: [{PARAMETERS}]"),
        &format!("topics: [/**], services: [{PARAMETERS}], prefix: /robot7"),
    );
    let _robot = site.begin("robot", &format!("{{domain_id: {near}}}"), &expose);
    let _cloud = site.begin("cloud", &format!("{{domain_id: {far}}}"), &import);
    // After its messages it answers requests.
    let options = ["--node", "/camera/driver", "--topic", "/camera/text", "--count", "1"];
    let _driver = Peer::topic(Vendor::Rclpy, "talk", near, &options);
    let mut seen = Peer::graph(far, Some("/robot7/camera/driver"));

    // As `ros2 param list`, `get`, `set` and `get` do.
    let parameters = seen.event("parameters").await;
    let is_listed = parameters["names"].as_array().is_some_and(|names| names.contains(&"use_sim_time".into()));
    assert!(is_listed, "{parameters}: {} {}", site.log("robot"), site.log("cloud"));
    assert_eq!(parameters["use_sim_time"], json!([false, true]), "{parameters}");

    let driver = "/robot7/camera/driver";
    let list_parameters = format!("{driver}/list_parameters");
    let is_whole = |graph: &Value| {
        let node = &graph["nodes"][driver];
        !node["publishers"]["/robot7/camera/text"].is_null() && !node["servers"][&list_parameters].is_null()
    };
    let graph = until(&mut seen, is_whole).await;
    let node = &graph["nodes"][driver];
    assert_eq!(node["publishers"]["/robot7/camera/text"][0], "std_msgs/msg/String");
    let servers = &node["servers"];
    assert_eq!(servers[&list_parameters][0], "rcl_interfaces/srv/ListParameters", "{servers}");
    let publishers = graph["topics"]["/robot7/camera/text"].as_array().unwrap();
    assert_eq!(publishers.len(), 1, "{publishers:?}");
    let publisher = &publishers[0];
    assert_eq!((&publisher["node"], &publisher["hash"]), (&driver.into(), &STRING.into()), "{publisher}");
    assert_eq!(publisher["reliability"], "RELIABLE");
    // The proxies are nodes as well, and have nothing of the others.
    let nodes = graph["nodes"].as_object().unwrap();
    let proxies: Vec<_> = nodes.iter().filter(|(name, _)| name.starts_with("/gdp_proxy_")).collect();
    assert_eq!(proxies.len(), 1, "{nodes:?}");
    assert!(proxies[0].1["publishers"]["/robot7/camera/text"].is_null());
}

async fn until(seen: &mut Peer, is_so: impl Fn(&Value) -> bool) -> Value {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        let graph = seen.event("graph").await;
        if is_so(&graph) {
            return graph;
        }
        assert!(Instant::now() < deadline, "{graph:#}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_life_cycle_of_a_far_node_is_read_and_changed() {
    let site = Site::start().await;
    let (near, far) = (lease(), lease());
    let services = "services: [/camera/**]";
    let (expose, import) = site.by_pattern("robot", "cloud", services, &format!("{services}, prefix: /robot7"));
    let _robot = site.begin("robot", &format!("{{domain_id: {near}}}"), &expose);
    let _cloud = site.begin("cloud", &format!("{{domain_id: {far}}}"), &import);
    let lifecycle = |domain, arguments: &[&str]| Peer::rclpy("rclpy_lifecycle.py", domain, arguments);
    let mut driver = lifecycle(near, &["serve", "/camera/driver"]);
    driver.event("ready").await;
    let mut operator = lifecycle(far, &["drive", "/robot7/camera/driver", "configure"]);
    assert_eq!(operator.event("found").await["types"][0], "lifecycle_msgs/srv/GetState");
    assert_eq!(operator.event("state").await["label"], "unconfigured");
    assert_eq!(operator.event("changed").await["success"], true);
    driver.event("configured").await;
    assert_eq!(operator.event("state").await["label"], "inactive");
}
