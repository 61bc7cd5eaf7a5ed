//! Several robots with the same frames, whose topics merge elsewhere; and what is compressed on its
//! way there.
//!
//! ```text
//!    robot1 ── proxy ─┐
//!                     switch ── proxy ── cloud
//!    robot2 ── proxy ─┘
//! ```

use gdp_tests::dds_domain::lease;
use std::collections::BTreeSet;
use std::fs;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp_e2e::seal::Encoding;
use gdp_msg::{Dialect, Mapping, Options, Registry, Schema};
use gdp_proxy::ros2::{Domain, RawReader, RawSample, TypeName};
use gdp_ros::roster::{Dialect as RosDialect, Kind, Outgoing, ROSTER};
use serde_json::Value;

use super::lives::{domain, received, status, topic};
use super::site::Site;
use super::{LATCHED, RELIABLE, within};

/// From each to the next, in messages that are long enough to be compressed.
const MOVING: [&str; 6] = ["/map", "odom", "base_link", "a", "b", "c"];
const FIXED: [&str; 5] = ["base_link", "laser", "camera", "arm", "hand"];

#[tokio::test(flavor = "multi_thread")]
async fn the_frames_of_two_robots_merge_and_are_told_apart() {
    let site = Site::start().await;
    let ids = [(); 3].map(|()| lease());
    let topics = ["/tf", "/tf_static"].map(|name| site.topic(name, "tf2_msgs/msg/TFMessage"));
    let mut plain = site.subscribe(&topics[0]).await;
    let _robots = [("robot1", ids[0]), ("robot2", ids[1])].map(|(robot, id)| {
        let says = format!("direction: out, compression: zstd, frame_prefix: {robot}/");
        site.proxy(robot, &domain(id), &topics, &says)
    });
    let (graphs, frames) = ([ids[0], ids[1]].map(|id| Domain::join(id, "robot").unwrap()), Frames::new());
    let mut talking = Vec::new();
    for graph in &graphs {
        let mut fixed = graph.writer(&topic("/tf_static"), &kind(), &LATCHED).unwrap();
        fixed.write(frames.message(&FIXED), 0).await.unwrap();
        let mut writer = graph.writer(&topic("/tf"), &kind(), &RELIABLE).unwrap();
        let moving = frames.message(&MOVING);
        talking.push(tokio::spawn(async move {
            loop {
                writer.write(moving.clone(), 0).await.unwrap();
                tokio::time::sleep(Duration::from_millis(50)).await;
                // What is latched is so as long as its writer is there.
                let _ = &fixed;
            }
        }));
    }
    // It really travels so.
    let compressed = async {
        loop {
            let message = plain.recv().await.unwrap();
            if message.encoding != ROSTER {
                break message;
            }
        }
    };
    assert_eq!(within("a message", compressed).await.encoding, Encoding::Other(0x8002));

    let _cloud = site.proxy("cloud", &domain(ids[2]), &topics, "direction: in");
    let cloud = Domain::join(ids[2], "cloud").unwrap();
    let moving = cloud.reader(&topic("/tf"), &kind(), &RELIABLE).unwrap();
    let fixed = cloud.reader(&topic("/tf_static"), &kind(), &LATCHED).unwrap();
    let transforms = |robot: &str, chain: &[&str]| {
        let pair =
            |pair: &[&str]| (format!("{robot}/{}", pair[0].trim_start_matches('/')), format!("{robot}/{}", pair[1]));
        chain.windows(2).map(pair).collect::<BTreeSet<_>>()
    };
    for (reader, chain) in [(&moving, &MOVING[..]), (&fixed, &FIXED[..])] {
        let expected = ["robot1", "robot2"].map(|robot| transforms(robot, chain));
        let mut seen = BTreeSet::new();
        while seen.len() < 2 {
            let read = frames.read(reader).await;
            assert!(expected.contains(&read), "{read:?}");
            seen.insert(read);
        }
    }

    let counted = |label: &str| {
        let stats = fs::read(site.folder(label).join("stats.json")).unwrap_or_default();
        let stats: Value = serde_json::from_slice(&stats).unwrap_or_default();
        ["bytes", "bytes_carried"].map(|key| stats["topics"][0][key].as_u64().unwrap_or(0))
    };
    for label in ["robot1", "cloud"] {
        super::until("what was saved is counted", || counted(label)[1] > 0).await;
        let [bytes, carried] = counted(label);
        assert!(carried < bytes, "{label}: {carried} of {bytes}");
    }
    talking.into_iter().for_each(|talker| talker.abort());
    for graph in graphs.into_iter().chain([cloud]) {
        graph.leave().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_a_type_that_nobody_knows_do_not_cross_and_the_status_says_why() {
    let site = Site::start().await;
    let ids = [(); 2].map(|()| lease());
    let topics = [site.topic("/own", "my_robot/msg/Unheard")];
    let out = site.proxy("robot", &domain(ids[0]), &topics, "direction: out, frame_prefix: r1/");
    let graph = Domain::join(ids[0], "robot").unwrap();
    let own = TypeName::parse("my_robot/msg/Unheard").unwrap();
    let _writer = graph.writer(&topic("/own"), &own, &RELIABLE).unwrap();
    let expected = "to put a prefix in front of frames, one must know the type";
    status(&out, expected).await;

    let into = site.proxy("cloud", &domain(ids[1]), &topics, "direction: in, frame_prefix: r1/");
    let publisher = site.publish(&topics[0]).await;
    let own = Kind { dialect: RosDialect::Ros2, name: own.to_string(), hash: vec![] };
    let mut roster = Outgoing::new(own, None);
    roster.joined('a', "", RELIABLE);
    roster.announce(Instant::now(), &publisher).unwrap();
    status(&into, expected).await;
    graph.leave().await;
}

/// Messages of `tf2_msgs/msg/TFMessage`.
struct Frames {
    schema: Arc<Schema>,
}

impl Frames {
    fn new() -> Self {
        let name = gdp_msg::TypeName::parse("tf2_msgs/TFMessage").unwrap();
        Self { schema: Schema::resolve(&Registry::embedded(), Dialect::Ros2, &name).unwrap() }
    }

    /// From each of these to the next.
    fn message(&self, chain: &[&str]) -> RawSample {
        let transform = |pair: &[&str]| {
            let header = serde_json::json!({"stamp": {"sec": 1, "nanosec": 2}, "frame_id": pair[0]});
            let (at, turned) =
                (serde_json::json!({"x": 1, "y": 2, "z": 3}), serde_json::json!({"x": 0, "y": 0, "z": 0, "w": 1}));
            let transform = serde_json::json!({"translation": at, "rotation": turned});
            serde_json::json!({"header": header, "child_frame_id": pair[1], "transform": transform})
        };
        let json = serde_json::json!({"transforms": chain.windows(2).map(transform).collect::<Vec<_>>()});
        let cdr = self.transcode(gdp_msg::Encoding::Json, gdp_msg::Encoding::Cdr, json.to_string().as_bytes());
        RawSample::parse(Bytes::from(cdr)).unwrap()
    }

    /// The next message: from where to where.
    async fn read(&self, reader: &RawReader) -> BTreeSet<(String, String)> {
        let json = self.transcode(gdp_msg::Encoding::Cdr, gdp_msg::Encoding::Json, &received(reader).await);
        let message: Value = serde_json::from_slice(&json).unwrap();
        let text = |value: &Value| value.as_str().unwrap().to_owned();
        let transforms = message["transforms"].as_array().unwrap().iter();
        transforms.map(|one| (text(&one["header"]["frame_id"]), text(&one["child_frame_id"]))).collect()
    }

    fn transcode(&self, from: gdp_msg::Encoding, to: gdp_msg::Encoding, message: &[u8]) -> Vec<u8> {
        let mut output = Vec::new();
        let mapping = Mapping::within(&self.schema, from, to).unwrap();
        mapping.transcode(message, &mut output, &Options::default()).unwrap();
        output
    }
}

fn kind() -> TypeName {
    TypeName::parse("tf2_msgs/msg/TFMessage").unwrap()
}
