//! Late subscribers get as much of a latched topic as its publisher keeps.

use gdp_tests::dds_domain::lease;
use std::time::Duration;

use crate::peer::{Peer, Vendor};
use crate::site::Site;

/// What discovery does not tell.
const DEPTH: i64 = 5;

/// More than the depth.
const MESSAGES: i64 = 8;

#[tokio::test(flavor = "multi_thread")]
async fn late_subscribers_get_as_many_messages_as_the_publisher_keeps() {
    for vendor in [Vendor::Rclpy, Vendor::Cyclone] {
        let site = Site::start().await;
        let (near, far) = (lease(), lease());
        let topics = [site.topic("/chatter", "std_msgs/msg/String")];
        let mut early = Peer::topic(Vendor::Rclpy, "listen", far, &["--transient-local"]);
        early.event("ready").await;
        let gate = site.folder("gate").join("open");
        let (depth, count, gate) = (DEPTH.to_string(), MESSAGES.to_string(), gate.to_str().unwrap());
        let says = ["--transient-local", "--depth", &depth, "--rate", "20", "--count", &count, "--gate", gate];
        let mut talker = Peer::topic(vendor, "talk", near, &says);
        let _out = site.proxy("robot", &domain(near), &topics, "direction: out");
        let _in = site.proxy("cloud", &domain(far), &topics, "direction: in");
        // Warm-up messages cross. The depth of the mirrored publisher grows while they do.
        early.event("message").await;
        std::fs::write(gate, "").unwrap();
        for sequence in 0..MESSAGES {
            assert_eq!(early.message().await["seq"], sequence, "{vendor:?}: each once, in order");
        }
        talker.event("done").await;
        // At the talker's own site, then elsewhere. The subscriber asks for more than there is.
        for at in [near, far] {
            let mut late = Peer::topic(Vendor::Rclpy, "listen", at, &["--transient-local", "--depth", "100"]);
            let mut heard = vec![];
            while heard.last() != Some(&(MESSAGES - 1)) {
                heard.push(late.event("message").await["seq"].as_i64().unwrap());
            }
            let all = (MESSAGES - DEPTH..MESSAGES).collect::<Vec<_>>();
            assert_eq!(heard, all, "{vendor:?} at {at}, {near} is the talker's");
            assert!(!late.hears_within(Duration::from_millis(500)).await, "{vendor:?}");
        }
        assert!(!early.hears_within(Duration::from_millis(100)).await, "{vendor:?}: nothing twice");
    }
}

fn domain(id: u16) -> String {
    format!("{{domain_id: {id}}}")
}
