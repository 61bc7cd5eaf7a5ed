//! Small messages pass the proxies without their tasks, and overtake no large ones.

use std::time::Duration;

use gdp_proxy::ros2::{Domain, TopicName, TypeName};
use gdp_ros::roster::Offer;
use gdp_tests::dds_domain::lease;
use serde_json::Value;

use super::{RELIABLE, cdr, site::Site, text, within};

/// Every third message is too large for the direct path.
const MESSAGES: usize = 300;

#[tokio::test(flavor = "multi_thread")]
async fn small_messages_pass_the_tasks_by_and_overtake_no_large_ones() {
    let site = Site::start().await;
    let ids = [(); 2].map(|()| lease());
    let topics = [site.topic("/mixed", "std_msgs/msg/String")];
    let domain = |id: u16| format!("{{domain_id: {id}}}");
    let _out = site.proxy("robot", &domain(ids[0]), &topics, "direction: out");
    let _in = site.proxy("cloud", &domain(ids[1]), &topics, "direction: in");
    let [robot, cloud] = [("robot", ids[0]), ("cloud", ids[1])].map(|(node, id)| Domain::join(id, node).unwrap());
    let (topic, kind) = (TopicName::parse("/mixed").unwrap(), TypeName::parse("std_msgs/msg/String").unwrap());
    let deep = Offer { depth: 1000, ..RELIABLE };
    let reader = cloud.reader(&topic, &kind, &deep).unwrap();
    let mut writer = robot.writer(&topic, &kind, &deep).unwrap();

    // The path is complete once a message has come through it.
    within("the first message", async {
        loop {
            writer.write(cdr("0"), 0).await.unwrap();
            if tokio::time::timeout(Duration::from_millis(50), reader.recv()).await.is_ok() {
                break;
            }
        }
    })
    .await;
    let writing = tokio::spawn(async move {
        for number in 1..=MESSAGES {
            let padding = if number.is_multiple_of(3) { 40_000 } else { 1 };
            writer.write(cdr(&format!("{number}{}", " ".repeat(padding))), 0).await.unwrap();
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        writer
    });
    let mut last = 0;
    while last < MESSAGES {
        let message = within("a message", reader.recv()).await.unwrap().sample.bytes;
        let number: usize = text(&message).trim_end().parse().unwrap();
        assert!(number == last + 1 || number == 0, "{number} came after {last}");
        last = number;
    }
    drop(writing.await.unwrap());

    for label in ["robot", "cloud"] {
        let direct = || {
            let stats = std::fs::read(site.folder(label).join("stats.json")).unwrap_or_default();
            let stats: Value = serde_json::from_slice(&stats).unwrap_or_default();
            stats["topics"][0]["direct"].as_u64().unwrap_or(0)
        };
        super::until("small messages took the direct path", || direct() > MESSAGES as u64 / 4).await;
        assert!(direct() < MESSAGES as u64, "the large ones did not");
    }
    for graph in [robot, cloud] {
        graph.leave().await;
    }
}
