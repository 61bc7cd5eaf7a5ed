//! Graphs with more topics than a proxy carries: the log says so in a few lines.

use gdp_tests::dds_domain::lease;
use std::time::Duration;

use gdp_ros::catalog::MAX_ENTRIES;
use gdp_util::descriptors::raise_limit;

use super::graph;
use super::master::Master;
use super::peer::{Peer, Vendor};
use super::site::Site;

/// Warnings that a log may have, however many topics there are.
const MOST_WARNINGS: usize = 20;

/// Of a proxy in one DDS domain, however many topics it carries.
const MOST_DESCRIPTORS: usize = 100;

/// Time to make and to find thousands of topics on a busy machine.
const LIMIT: Duration = Duration::from_secs(300);

#[tokio::test(flavor = "multi_thread")]
async fn twenty_thousand_topics_of_rospy_are_a_few_lines_of_the_log() {
    const PEERS: usize = 4;
    const TOPICS: usize = 5_000;
    // A topic that is carried has up to four files open.
    raise_limit().unwrap();
    let (site, master) = (Site::start().await, Master::start().await);
    let (expose, _) = site.by_pattern("robot", "cloud", "topics: [/**]", "topics: [/**]");
    let _proxy = site.begin("robot", &graph(&master), &expose);
    let mut peers: Vec<_> = (0..PEERS)
        .map(|i| master.begin(&format!("many{i}"), &["publish-many", &format!("/m{i}/t"), &TOPICS.to_string()]))
        .collect();
    for peer in &mut peers {
        for _ in 0..TOPICS / 1000 {
            peer.event("published").await;
        }
    }
    shown_in_a_few_lines(&site).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn five_thousand_topics_of_a_dds_participant_are_a_few_lines_of_the_log() {
    let site = Site::start().await;
    let domain = lease();
    let (expose, _) = site.by_pattern("robot", "cloud", "topics: [/**]", "topics: [/**]");
    let proxy = site.begin("robot", &format!("{{domain_id: {domain}}}"), &expose);
    let mut peer = Peer::topic(Vendor::Cyclone, "talk", domain, &["--no-wait", "--more-topics", "5000"]);
    peer.event("ready").await;
    shown_in_a_few_lines(&site).await;
    // All endpoints of a participant share its sockets.
    let open = proxy.descriptors();
    assert!(open < MOST_DESCRIPTORS, "{open} open files for {MAX_ENTRIES} topics");
}

/// Waits until the proxy carries all it can and says that there are more.
async fn shown_in_a_few_lines(site: &Site) {
    let deadline = std::time::Instant::now() + LIMIT;
    let is_shown = || site.carried("robot").len() == MAX_ENTRIES && warnings(site).iter().any(|line| is_summary(line));
    while !is_shown() {
        let (carried, warnings) = (site.carried("robot").len(), warnings(site));
        assert!(std::time::Instant::now() < deadline, "{carried} carried; {} warnings: {warnings:#?}", warnings.len());
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    let warnings = warnings(site);
    assert!(warnings.len() <= MOST_WARNINGS, "{} warnings, such as {:#?}", warnings.len(), &warnings[..MOST_WARNINGS]);
}

fn is_summary(line: &str) -> bool {
    line.contains("names are not carried, such as topic /") && line.contains("names in the catalog already")
}

fn warnings(site: &Site) -> Vec<String> {
    site.log("robot").lines().filter(|line| line.contains(" WARN ")).map(str::to_owned).collect()
}
