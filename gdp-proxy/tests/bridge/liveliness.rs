//! The liveliness of publishers: what watchdogs of robots rely on.

use gdp_tests::dds_domain::lease;
use std::fs;
use std::time::{Duration, Instant};

use crate::peer::{Peer, Vendor};
use crate::site::Site;

/// The lease of the publishers.
const LEASE: Duration = Duration::from_secs(1);

/// How much later than the lease its end may be seen elsewhere.
const LATE: Duration = Duration::from_millis(100);

/// Attempts to see it in time: other tests may keep the processors busy meanwhile.
const ATTEMPTS: usize = 5;

/// Bound on that on a busy machine. Without watching the lease it is the lease of the participant,
/// 20 s.
const BUSY: Duration = Duration::from_secs(8);

#[tokio::test(flavor = "multi_thread")]
async fn the_end_of_a_killed_publisher_is_seen_elsewhere_when_its_lease_ends() {
    for vendor in [Vendor::Rclpy, Vendor::Cyclone] {
        let site = Site::start().await;
        let (near, far) = (lease(), lease());
        let topics = [site.topic("/chatter", "std_msgs/msg/String")];
        let _out = site.proxy("robot", &domain(near), &topics, "direction: out");
        let _in = site.proxy("cloud", &domain(far), &topics, "direction: in");
        let lease = LEASE.as_millis().to_string();
        let mut listener = Peer::topic(Vendor::Rclpy, "listen", far, &["--lease", &lease]);
        let mut seen = Vec::new();
        while seen.iter().all(|seen| *seen > LEASE + LATE) {
            assert!(seen.len() < ATTEMPTS, "{vendor:?}: {seen:?}");
            let talker = Peer::topic(vendor, "talk", near, &["--lease", &lease, "--rate", "20"]);
            assert_eq!(alive(&mut listener).await, 1, "{vendor:?}");
            listener.event("message").await;
            let killed = Instant::now();
            talker.kill().await;
            while alive(&mut listener).await != 0 {}
            seen.push(killed.elapsed());
            assert!(seen.iter().all(|seen| *seen < LEASE + BUSY), "{vendor:?}: {seen:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_publisher_that_asserts_its_liveliness_by_itself_is_alive_while_it_does() {
    let site = Site::start().await;
    let (near, far) = (lease(), lease());
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let _out = site.proxy("robot", &domain(near), &topics, "direction: out");
    let _in = site.proxy("cloud", &domain(far), &topics, "direction: in");
    let folder = tempfile::tempdir().unwrap();
    let gate = folder.path().join("gate");
    let lease = LEASE.as_millis().to_string();
    // Asks for liveliness by topic, which a publisher with automatic liveliness does not match.
    let mut listener = Peer::topic(Vendor::Rclpy, "listen", far, &["--lease", &lease, "--manual"]);
    let gated = ["--lease", &lease, "--manual", "--gate", gate.to_str().unwrap(), "--count", "1"];
    let mut talker = Peer::topic(Vendor::Rclpy, "talk", near, &gated);
    assert_eq!(alive(&mut listener).await, 1);
    // It publishes nothing, for several leases.
    let silent = tokio::time::timeout(3 * LEASE, alive(&mut listener)).await;
    assert!(silent.is_err(), "it is alive as long as it says so: {silent:?}");
    // It publishes a last message, and runs on.
    fs::write(&gate, "").unwrap();
    assert_eq!(listener.message().await["seq"], 0);
    talker.event("done").await;
    let last = Instant::now();
    assert_eq!(alive(&mut listener).await, 0);
    assert!(last.elapsed() < LEASE + BUSY, "{:?}", last.elapsed());
}

/// The next number of publishers that are alive, as the listener says it.
async fn alive(listener: &mut Peer) -> u64 {
    listener.event("liveliness").await["alive"].as_u64().unwrap()
}

fn domain(id: u16) -> String {
    format!("{{domain_id: {id}}}")
}
