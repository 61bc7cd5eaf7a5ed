//! Proxies with different back ends of cryptography understand each other: what one seals, signs
//! and wraps, the other opens and verifies.

use gdp_proxy::ros2::{Domain, TopicName, TypeName};
use gdp_ros::roster::Offer;
use gdp_tests::dds_domain::lease;

use super::{RELIABLE, cdr, site::Site, text, until, within};

/// One segment, and many.
const SIZES: [usize; 2] = [10, 100_000];

#[tokio::test(flavor = "multi_thread")]
async fn proxies_with_different_back_ends_of_cryptography_exchange_messages() {
    let site = Site::start().await;
    let ids = [(); 2].map(|()| lease());
    let domain = |id: u16| format!("{{domain_id: {id}}}");
    let topic = |name: &str| TopicName::parse(name).unwrap();
    let kind = TypeName::parse("std_msgs/msg/String").unwrap();
    let patterns = "topics: [/there, /back]";
    let (out, taken) = site.by_pattern("robot", "cloud", patterns, patterns);
    let (back, received) = site.by_pattern("cloud", "robot", patterns, patterns);
    let robot = site.begin("robot", &domain(ids[0]), &format!("crypto: rustcrypto\n{out}{received}"));
    let cloud = site.begin("cloud", &domain(ids[1]), &format!("crypto: aws-lc\n{back}{taken}"));

    let graphs = [("robot", ids[0]), ("cloud", ids[1])].map(|(node, id)| Domain::join(id, node).unwrap());
    let latched = Offer { transient_local: true, depth: 4, ..RELIABLE };
    for (name, from, to) in [("/there", 0, 1), ("/back", 1, 0)] {
        let mut writer = graphs[from].writer(&topic(name), &kind, &latched).unwrap();
        for size in SIZES {
            writer.write(cdr(&"x".repeat(size)), 0).await.unwrap();
        }
        let reader = graphs[to].reader(&topic(name), &kind, &latched).unwrap();
        for size in SIZES {
            let message = within(name, reader.recv()).await.unwrap().sample.bytes;
            assert_eq!(text(&message), "x".repeat(size), "{name}");
        }
    }

    for (label, crypto) in [("robot", "crypto=rustcrypto"), ("cloud", "crypto=aws-lc")] {
        assert!(site.log(label).contains(crypto), "{}", site.log(label));
    }
    // A running proxy keeps its back end, and says so.
    let config = format!("crypto: aws-lc\n{out}{received}");
    site.configure("robot", &domain(ids[0]), &config);
    until("the change is refused", || site.log("robot").contains("crypto: cannot change while the proxy runs")).await;
    drop((robot, cloud));
    for graph in graphs {
        graph.leave().await;
    }
}
