//! What a newcomer finds after thousands of endpoints have come and gone, how soon, and what the
//! participants remember of them. It is a program of its own, because it measures its memory.

#[path = "../vendors/messages.rs"]
mod messages;
#[allow(dead_code, reason = "the tests of vendors, whose it is, use the rest")]
#[path = "../vendors/peer.rs"]
mod peer;

use std::time::{Duration, Instant};

use gdp_proxy::ros2::{Domain, Qos, RawWriter, TopicName};
use gdp_ros::roster::Offer;
use gdp_tests::dds_domain::lease;

use messages::{string, topic, write};
use peer::{Peer, Vendor, within};

/// Endpoints that come and go before memory is measured the first and the second time.
const FIRST: usize = 1_000;
const ALL: usize = 20_000;

/// Measurements of memory of which the smallest counts, a second apart.
const MEASUREMENTS: usize = 10;

/// What a newcomer needs may vary by this much on a busy machine.
const SLACK: Duration = Duration::from_millis(1500);

/// A newcomer finds what is there, however much has come and gone before it, and no later.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn newcomers_find_the_oldest_writer_and_none_of_thousands_that_are_gone() {
    // In a domain of its own: what was killed here would be waited for there.
    let (fresh_id, id) = (lease(), lease());
    let fresh = Domain::join(fresh_id, "gdp_proxy_test").unwrap();
    let _fresh_oldest = oldest(&fresh).await;
    let before = times(fresh_id).await;

    let here = Domain::join(id, "gdp_proxy_test").unwrap();
    let _oldest = oldest(&here).await;
    // It is told of every endpoint, and remembers as well.
    let witness = Domain::join(id, "witness").unwrap();
    come_and_go(&here, 0..FIRST).await;
    let early = Memory::settled(&witness).await;
    come_and_go(&here, FIRST..ALL).await;
    let late = Memory::settled(&witness).await;
    let after = times(id).await;
    for (Memory { resident_kb, allocated_kb }, endpoints) in [(early, FIRST), (late, ALL)] {
        println!("after {endpoints} endpoints: {resident_kb} kB resident, {allocated_kb} kB allocated");
    }
    for ((vendor, before), (_, after)) in before.iter().zip(&after) {
        println!("{vendor:?}: found after {before:?} at the start, after {after:?} at the end");
    }
    assert!(late.allocated_kb * 10 <= early.allocated_kb * 11, "{early:?}, then {late:?}");
    // A thousand endpoints a second leave gaps in the heap.
    assert!(late.resident_kb * 4 <= early.resident_kb * 5, "{early:?}, then {late:?}");
    for ((vendor, before), (_, after)) in before.into_iter().zip(after) {
        assert!(after <= before * 3 / 2 + SLACK, "{vendor:?}: {before:?}, then {after:?}");
    }

    // Also the first graph that a tool reads has nothing of what is gone.
    let mut tool = Peer::graph(id, None);
    within("the oldest writer in rclpy's graph", async {
        loop {
            let graph = tool.event("graph").await;
            let topics = graph["topics"].as_object().unwrap();
            assert!(!topics.keys().any(|topic| topic.starts_with("/gone_")), "{topics:?}");
            if topics.contains_key("/chatter") {
                break;
            }
        }
    })
    .await;
    let graph_observer = Domain::join(id, "graph_observer").unwrap();
    let mut graph = graph_observer.graph();
    within("the oldest writer", async {
        while !graph.borrow_and_update().topics.contains_key(&topic()) {
            graph.changed().await.unwrap();
            assert!(graph.borrow().topics.len() <= 1, "{:?}", graph.borrow().topics.keys());
        }
    })
    .await;
    fresh.leave().await;
    here.leave().await;
    witness.leave().await;
    graph_observer.leave().await;
}

fn latched() -> Offer {
    Offer { transient_local: true, depth: 1, ..Qos::default().into() }
}

/// The writer that is there all the time, with a message for whoever comes later.
async fn oldest(domain: &Domain) -> RawWriter {
    let mut writer = domain.writer(&topic(), &string(), &latched()).unwrap();
    write(&mut writer, 7, 64).await;
    writer
}

/// Creates a writer of a new topic for each number, and drops it.
async fn come_and_go(domain: &Domain, numbers: std::ops::Range<usize>) {
    for number in numbers {
        let topic = TopicName::parse(&format!("/gone_{number}")).unwrap();
        drop(domain.writer(&topic, &string(), &latched()).unwrap());
        tokio::task::yield_now().await;
    }
}

/// How long a newcomer of each vendor takes, from its subscription to the message of the oldest
/// writer. One at a time.
async fn times(id: u16) -> Vec<(Vendor, Duration)> {
    let mut times = Vec::new();
    for vendor in Vendor::ALL {
        let mut newcomer = Peer::topic(vendor, "listen", id, &["--transient-local"]);
        newcomer.event("ready").await;
        let since = Instant::now();
        assert_eq!(newcomer.message().await["seq"], 7, "{vendor:?}");
        times.push((vendor, since.elapsed()));
    }
    times
}

/// What this process uses.
#[derive(Clone, Copy, Debug)]
struct Memory {
    resident_kb: usize,
    /// What the program has allocated and not freed.
    allocated_kb: usize,
}

impl Memory {
    /// Waits until the witness knows no topic that is gone. Then returns the smallest figures of
    /// some measurements: the participants clean up every few seconds.
    async fn settled(witness: &Domain) -> Self {
        let mut graph = witness.graph();
        within("the end of all topics", async {
            while graph.borrow_and_update().topics.len() != 1 {
                graph.changed().await.unwrap();
            }
        })
        .await;
        let mut least = Self::now();
        for _ in 0..MEASUREMENTS {
            tokio::time::sleep(Duration::from_secs(1)).await;
            let now = Self::now();
            least.resident_kb = least.resident_kb.min(now.resident_kb);
            least.allocated_kb = least.allocated_kb.min(now.allocated_kb);
        }
        least
    }

    fn now() -> Self {
        // Otherwise what the allocator has not returned to the system would count.
        // SAFETY: both functions lock the allocator and take no pointers.
        let allocated = unsafe {
            libc::malloc_trim(0);
            libc::mallinfo2().uordblks
        };
        let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
        // The second field is in pages of 4 kB (proc_pid_statm(5)).
        let pages: usize = statm.split(' ').nth(1).unwrap().parse().unwrap();
        Self { resident_kb: pages * 4, allocated_kb: allocated / 1024 }
    }
}
