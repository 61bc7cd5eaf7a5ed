//! Where a message's time goes in the fabric, by the statistics of both proxies.

use serde::Serialize;
use serde_json::Value;

use super::site::Site;
use super::workload::Workload;

/// Medians of a topic from robot to edge, in milliseconds; `None` where a proxy has not stated one.
#[derive(Serialize)]
pub struct Stages {
    pub topic: &'static str,
    /// From the robot's program into its proxy, by DDS.
    pub dds_ms: Option<f64>,
    /// To seal, sign and send, with the switches' work, which runs inside the send.
    pub send_ms: Option<f64>,
    /// From sealed at the robot to verified at the edge, which contains the above.
    pub fabric_ms: Option<f64>,
    /// To write into the edge's DDS.
    pub write_ms: Option<f64>,
}

impl Stages {
    /// Returns the stages of the topics that the workload sends to the edge; none without proxies.
    pub fn of(site: &Site, workload: Workload) -> Vec<Self> {
        let Some([robot, edge]) = site.proxy_stats() else { return Vec::new() };
        let to_edge = workload.topics().iter().filter(|topic| topic.from_robot);
        to_edge.map(|topic| Self::of_topic(topic.topic, &robot, &edge)).collect()
    }

    fn of_topic(topic: &'static str, robot: &Value, edge: &Value) -> Self {
        let median = |stats: &Value, stage: &str| {
            let of_topic = stats["topics"].as_array()?.iter().find(|it| it["topic"] == topic)?;
            Some(of_topic["latency_us"][stage]["p50"].as_f64()? / 1e3)
        };
        Self {
            topic,
            dds_ms: median(robot, "arrival"),
            send_ms: median(robot, "handling"),
            fabric_ms: median(edge, "arrival"),
            write_ms: median(edge, "handling"),
        }
    }
}
