//! A participant of the proxy among real programs of every DDS vendor (`tests/peers`), over
//! loopback and with the system's default socket buffers. No root, no fabric. `cargo xtask test`
//! builds the programs.
//!
//! Every test has a DDS domain of its own.

mod messages;
#[allow(dead_code, reason = "the tests of graphs of rmw_zenoh use the rest")]
mod peer;

use std::sync::Arc;
use std::time::Duration;

use gdp_proxy::ros2::{
    Domain, Graph, Mapping, Qos, RawReader, RawSample, RawWriter, Reliability, Server, ServiceInfo, TopicName, TypeName,
};

use gdp_ros::roster::Offer;
use gdp_tests::dds_domain::lease;
use messages::{cdr, message, string, topic, write};
use peer::{Peer, Vendor, within};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_service_of_cyclone_is_called_and_one_is_offered_to_it() {
    service_both_ways(Vendor::Cyclone, lease()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_service_of_fast_dds_is_called_and_one_is_offered_to_it() {
    service_both_ways(Vendor::FastDds, lease()).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn services_of_both_distributions_of_ros_2_are_called_and_offered() {
    for vendor in [Vendor::Rclpy, Vendor::Jazzy] {
        lamp_both_ways(vendor, lease()).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_of_both_vendors_are_answered_by_one_server_while_it_lives() {
    let id = lease();
    let domain = Domain::join(id, "gdp_proxy_test").unwrap();
    let graph_observer = Domain::join(id, "graph_observer").unwrap();
    let server = domain.server(&service(), &add_two_ints(), None).unwrap();
    seen(&graph_observer, "the server", |service| service.servers.len() == 1).await;
    let answering = tokio::spawn(add(server));
    for vendor in [Vendor::Cyclone, Vendor::FastDds] {
        let mut client = Peer::call(vendor, id, 20, 22);
        assert_eq!(client.event("reply").await["sum"], 42, "{vendor:?}");
    }
    answering.abort();
    let _ = answering.await;
    seen(&graph_observer, "no server any more", |service| service.servers.is_empty()).await;
    domain.leave().await;
    graph_observer.leave().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_graph_has_what_vendors_announce_and_loses_what_leaves() {
    let id = lease();
    let domain = Domain::join(id, "gdp_proxy_test").unwrap();
    let mut talker = Peer::topic(Vendor::Cyclone, "talk", id, &["--transient-local", "--no-wait"]);
    let mut listener = Peer::topic(Vendor::FastDds, "listen", id, &["--best-effort"]);
    talker.event("ready").await;
    listener.event("ready").await;
    let chatter = topic();
    let graph = until(&domain, "both ends", |graph| {
        graph.topics.get(&chatter).is_some_and(|topic| topic.publishers.len() == 1 && topic.subscribers.len() == 1)
    })
    .await;
    let found = &graph.topics[&chatter];
    assert_eq!(found.publishers[0].kind, string());
    assert_eq!(found.publishers[0].qos.durability, gdp_proxy::ros2::Durability::TransientLocal);
    assert_eq!(found.subscribers[0].qos.reliability, Reliability::BestEffort);
    assert_eq!(graph.topics.len(), 1, "{graph:?}");
    // Killed, it says nothing: its lease has to end.
    listener.kill().await;
    until(&domain, "the subscriber's end", |graph| {
        graph.topics.get(&chatter).is_some_and(|topic| topic.subscribers.is_empty())
    })
    .await;
    domain.leave().await;
}

/// As after an outage of the network that is longer than the lease of the participants.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_participant_that_returns_after_its_lease_is_heard_again() {
    let id = lease();
    let domain = Domain::join(id, "gdp_proxy_test").unwrap();
    let reader = domain.reader(&topic(), &string(), &Qos::default().into()).unwrap();
    let talker = Peer::topic(Vendor::Cyclone, "talk", id, &["--rate", "20"]);
    within("a message", receive(&reader)).await;
    talker.signal(libc::SIGSTOP);
    let is_there = |graph: &Graph| graph.topics.get(&topic()).is_some_and(|topic| !topic.publishers.is_empty());
    until(&domain, "the end of the lease", |graph| !is_there(graph)).await;
    // What was under way.
    while tokio::time::timeout(Duration::from_millis(100), reader.recv()).await.is_ok() {}
    talker.signal(libc::SIGCONT);
    until(&domain, "the publisher", is_there).await;
    within("another message", receive(&reader)).await;
    domain.leave().await;
}

/// What a proxy mirrors of a publisher elsewhere, and takes away when that is lost.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lease_is_kept_while_the_writer_is_there_and_its_end_is_seen() {
    let id = lease();
    let domain = Domain::join(id, "gdp_proxy_test").unwrap();
    let lease_ns = 1_000_000_000;
    let offers = Offer { deadline_ns: lease_ns, liveliness_ns: lease_ns, ..Qos::default().into() };
    let mut writer = domain.writer(&topic(), &string(), &offers).unwrap();
    let mut listener = Peer::topic(Vendor::Cyclone, "listen", id, &["--lease", "1000"]);
    warm_up(&mut writer, &mut listener).await;
    // Nothing is written for several leases: the deadline is missed, and the writer lives.
    for _ in 0..3 {
        listener.event("deadline missed").await;
    }
    write(&mut writer, 0, 64).await;
    assert_eq!(listener.message().await["seq"], 0);
    drop(writer);
    let end = listener.event("liveliness").await;
    assert_eq!((end["alive"].as_u64(), end["lost"].as_u64()), (Some(0), Some(0)), "it was never lost before: {end}");
    domain.leave().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn large_messages_reach_every_vendor() {
    for vendor in Vendor::ALL {
        // The killed listener would be waited for, until its lease ends.
        let id = lease();
        let domain = Domain::join(id, "gdp_proxy_test").unwrap();
        let mut writer = domain.writer(&topic(), &string(), &Qos::default().into()).unwrap();
        let mut listener = Peer::topic(vendor, "listen", id, &[]);
        warm_up(&mut writer, &mut listener).await;
        for size in vendor.large() {
            for sequence in 0..5 {
                write(&mut writer, sequence, size).await;
                tokio::time::sleep(Duration::from_millis(33)).await;
            }
            for sequence in 0..5 {
                let message = listener.message().await;
                let got = (message["seq"].as_i64(), message["intact"].as_bool(), message["bytes"].as_u64());
                assert_eq!(got, (Some(sequence), Some(true), Some(size as u64)), "{vendor:?}");
            }
        }
        domain.leave().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn large_messages_come_from_every_vendor() {
    for vendor in Vendor::ALL {
        for size in LARGE {
            let id = lease();
            let domain = Domain::join(id, "gdp_proxy_test").unwrap();
            let reader = domain.reader(&topic(), &string(), &Qos::default().into()).unwrap();
            let size_text = size.to_string();
            let _talker = Peer::topic(vendor, "talk", id, &["--rate", "2", "--size", &size_text]);
            let mut came = Vec::new();
            while came.len() < 3 {
                came.push(within("a large message", receive(&reader)).await);
            }
            assert!(came.windows(2).all(|pair| pair[1].0 == pair[0].0 + 1), "{vendor:?} {size}: {came:?}");
            assert!(came.iter().all(|(_, bytes)| *bytes == size), "{vendor:?}: {came:?}");
            domain.leave().await;
        }
    }
}

/// A talker's last message is for late subscribers, in both directions.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn latched_messages_come_from_every_vendor_and_reach_it() {
    let latched = Offer { transient_local: true, depth: 1, ..Qos::default().into() };
    for vendor in Vendor::ALL {
        let id = lease();
        let domain = Domain::join(id, "gdp_proxy_test").unwrap();
        let options = ["--transient-local", "--no-wait", "--count", "3", "--rate", "100"];
        let mut talker = Peer::topic(vendor, "talk", id, &options);
        talker.event("done").await;
        let reader = domain.reader(&topic(), &string(), &latched).unwrap();
        let (mut last, size) = within("a latched message", receive(&reader)).await;
        while last < 2 {
            (last, _) = within("the last message", receive(&reader)).await;
        }
        assert_eq!((last, size), (2, 64), "{vendor:?}");
        drop(reader);
        talker.kill().await;

        let mut writer = domain.writer(&topic(), &string(), &latched).unwrap();
        write(&mut writer, 7, 64).await;
        let mut listener = Peer::topic(vendor, "listen", id, &["--transient-local"]);
        // What the killed talker sent may be there as well, by no other than itself.
        assert_eq!(listener.message().await["seq"], 7, "{vendor:?}");
        domain.leave().await;
    }
}

/// As the history policy KEEP_LAST says (DDS 1.4, 2.2.3.18), which is that of ROS 2: it replaces,
/// and does not wait.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reliable_listener_that_was_killed_or_stopped_takes_nothing_from_the_others() {
    const MESSAGES: i64 = 4000;
    for signal in [libc::SIGKILL, libc::SIGSTOP] {
        let id = lease();
        let domain = Domain::join(id, "gdp_proxy_test").unwrap();
        let mut writer = domain.writer(&topic(), &string(), &Qos::default().into()).unwrap();
        let depth = MESSAGES.to_string();
        let mut healthy = Peer::topic(Vendor::FastDds, "listen", id, &["--depth", &depth]);
        let mut lost = Peer::topic(Vendor::Cyclone, "listen", id, &[]);
        warm_up(&mut writer, &mut healthy).await;
        warm_up(&mut writer, &mut lost).await;
        lost.signal(signal);

        let mut ticks = tokio::time::interval(Duration::from_millis(1));
        for sequence in 0..MESSAGES {
            ticks.tick().await;
            writer.write(message(sequence, 64), 0).await.unwrap_or_else(|error| panic!("message {sequence}: {error}"));
        }
        for sequence in 0..MESSAGES {
            assert_eq!(healthy.message().await["seq"], sequence);
        }
        domain.leave().await;
    }
}

const LARGE: [usize; 3] = [1_000_000, 3_000_000, 10_000_000];

async fn service_both_ways(vendor: Vendor, id: u16) {
    let domain = Domain::join(id, "gdp_proxy_test").unwrap();
    let mut server = Peer::serve(vendor, id);
    server.event("ready").await;
    let found = seen(&domain, "the server", |service| service.servers.len() == 1).await;
    assert_eq!(found.servers[0].kind, add_two_ints());
    let mapping = found.servers[0].mapping;
    assert_eq!(mapping, vendor.mapping());
    let client = domain.client(&service(), &add_two_ints(), mapping).unwrap();
    let sum = within("an answer", async {
        loop {
            // What is asked before both ends have matched is answered by nobody; to give a call up
            // harms no other.
            let call = client.call(request(40, 2));
            if let Ok(reply) = tokio::time::timeout(Duration::from_millis(500), call).await {
                return number(&reply.unwrap(), 0);
            }
        }
    })
    .await;
    assert_eq!(sum, 42);
    let (one, other) = tokio::join!(client.call(request(1, 2)), client.call(request(10, 20)));
    assert_eq!((number(&one.unwrap(), 0), number(&other.unwrap(), 0)), (3, 30));
    server.kill().await;
    drop(client);

    let answering = tokio::spawn(add(domain.server(&service(), &add_two_ints(), None).unwrap()));
    let mut client = Peer::call(vendor, id, 7, 8);
    assert_eq!(client.event("reply").await["sum"], 15);
    answering.abort();
    let _ = answering.await;
    domain.leave().await;
}

/// Switches the lamp of a node on and off, and has one for it.
async fn lamp_both_ways(vendor: Vendor, id: u16) {
    let (lamp, kind) = (TopicName::parse(peer::LAMP).unwrap(), TypeName::parse("std_srvs/srv/SetBool").unwrap());
    let domain = Domain::join(id, "gdp_proxy_test").unwrap();
    let mut node = Peer::lamp(vendor, "switch", id);
    node.event("ready").await;
    until(&domain, "the server", |graph| graph.services.get(&lamp).is_some_and(|found| found.servers.len() == 1)).await;
    let client = domain.client(&lamp, &kind, vendor.mapping()).unwrap();
    let reply = within("an answer", async {
        loop {
            let call = client.call(cdr(&[1]));
            if let Ok(reply) = tokio::time::timeout(Duration::from_millis(500), call).await {
                return reply.unwrap();
            }
        }
    })
    .await;
    assert_eq!(reply.bytes[4], 1, "{vendor:?}");
    assert!(String::from_utf8_lossy(&reply.bytes).contains("/lamp is on"), "{vendor:?}: {:?}", reply.bytes);
    node.kill().await;
    drop(client);

    let server = domain.server(&lamp, &kind, None).unwrap();
    let answering = tokio::spawn(async move {
        loop {
            let request = server.recv().await.unwrap();
            let is_on = request.sample.bytes[4];
            let body = [&[is_on, 0, 0, 0][..], &5_u32.to_le_bytes(), b"done\0"].concat();
            server.respond(&request.id, &request.client, cdr(&body)).await.unwrap();
        }
    });
    let mut client = Peer::lamp(vendor, "set", id);
    for is_on in [true, false] {
        let response = client.event("response").await;
        assert_eq!((&response["success"], &response["message"]), (&is_on.into(), &"done".into()), "{vendor:?}");
    }
    answering.abort();
    let _ = answering.await;
    domain.leave().await;
}

/// Answers until it is stopped.
async fn add(server: Server) {
    loop {
        let request = server.recv().await.unwrap();
        let sum = number(&request.sample, 0) + number(&request.sample, 1);
        server.respond(&request.id, &request.client, cdr(&sum.to_le_bytes())).await.unwrap();
    }
}

/// Waits until the service is so.
async fn seen(domain: &Domain, what: &str, is_so: impl Fn(&ServiceInfo) -> bool) -> ServiceInfo {
    let of = |graph: &Graph| graph.services.get(&service()).cloned().unwrap_or_default();
    of(&*until(domain, what, |graph| is_so(&of(graph))).await)
}

async fn until(domain: &Domain, what: &str, is_so: impl Fn(&Graph) -> bool) -> Arc<Graph> {
    let mut graph = domain.graph();
    within(what, async { graph.wait_for(|graph| is_so(graph)).await.unwrap().clone() }).await
}

/// Writes until the listener hears.
async fn warm_up(writer: &mut RawWriter, listener: &mut Peer) {
    within("a first message", async {
        loop {
            write(writer, -1, 64).await;
            if listener.hears_within(Duration::from_millis(50)).await {
                return;
            }
        }
    })
    .await;
}

/// The sequence number and the bytes of the string.
async fn receive(reader: &RawReader) -> (i64, usize) {
    let sample = reader.recv().await.unwrap().sample;
    let length = u32::from_le_bytes(sample.bytes[4..8].try_into().unwrap()) as usize - 1;
    let text = std::str::from_utf8(&sample.bytes[8..8 + length]).unwrap();
    let mut parts = text.splitn(4, ' ');
    let mut part = || parts.next().unwrap();
    let (sequence, _, crc, filler) = (part(), part(), part(), part());
    assert_eq!(crc.parse::<u32>().unwrap(), crc32fast::hash(filler.as_bytes()), "{sequence}");
    (sequence.parse().unwrap(), length)
}

fn request(a: i64, b: i64) -> RawSample {
    cdr(&[a.to_le_bytes(), b.to_le_bytes()].concat())
}

/// The `index`-th int64 of a body.
fn number(sample: &RawSample, index: usize) -> i64 {
    let at = 4 + 8 * index;
    i64::from_le_bytes(sample.bytes[at..at + 8].try_into().unwrap())
}

fn service() -> TopicName {
    TopicName::parse(peer::SERVICE).unwrap()
}

fn add_two_ints() -> TypeName {
    TypeName::parse("example_interfaces/srv/AddTwoInts").unwrap()
}

impl Vendor {
    /// Sizes of messages that a listener receives. dust_dds ends with a panic when it asks a writer
    /// of any vendor for more than 256 missing fragments (`FragmentNumberSet::new`).
    fn large(self) -> [usize; 3] {
        if matches!(self, Self::Dust) { [10_000, 50_000, 100_000] } else { LARGE }
    }

    fn mapping(self) -> Mapping {
        match self {
            Self::Cyclone => Mapping::Cyclone,
            Self::FastDds | Self::Rclpy | Self::Jazzy | Self::Dust => Mapping::Enhanced,
        }
    }
}
