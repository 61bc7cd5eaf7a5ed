//! One copy of each message, however many proxies could carry it.

use gdp_tests::dds_domain::lease;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use gdp_proxy::ros2::{Domain, RawReader, RawWriter};
use gdp_ros::roster::{Dialect, Kind, Outgoing, ROSTER};

use crate::lives::{domain, string, topic};
use crate::site::{Proxy, Site};
use crate::{RELIABLE, TIMEOUT, cdr, text, until, within};

/// ```text
///    proxy a ──┐
///    domain x  ├── switch ── proxy c, domain y
///    proxy b ──┘
/// ```
#[tokio::test(flavor = "multi_thread")]
async fn of_two_proxies_in_one_graph_one_carries_and_the_other_takes_over() {
    let site = Site::start().await;
    let (x, y) = (lease(), lease());
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let start = |label, id| site.proxy(label, &domain(id), &topics, "direction: both");
    let mut twins = vec![start("a", x), start("b", x)];
    let _far = start("c", y);
    let mut ends = [End::join(x), End::join(y)];
    until("one stands by", || twins.iter().any(stands_by)).await;
    warm_up(&mut ends).await;
    each_is_heard_once(&mut ends).await;

    let first = twins.iter().position(|proxy| !stands_by(proxy)).unwrap();
    // Without a goodbye.
    drop(twins.remove(first));
    until("the other takes over", || !stands_by(&twins[0])).await;
    warm_up(&mut ends).await;
    each_is_heard_once(&mut ends).await;
    for end in ends {
        end.domain.leave().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_proxy_that_can_make_no_counterpart_leaves_the_topic_to_one_that_can() {
    let site = Site::start().await;
    let graph = domain(lease());
    let topics = [site.topic("/chatter", "")];
    let mut labels = ["a", "b"];
    labels.sort_by_key(|label| site.identity(label).name());
    let lower = site.proxy(labels[0], &graph, &topics, "direction: in, type: std_msgs/msg/Int32");
    let higher = site.proxy(labels[1], &graph, &topics, "direction: in");
    until("the lower name carries", || stands_by(&higher) && lower.statuses() == ["up"]).await;

    let publisher = site.publish(&topics[0]).await;
    let kind = Kind { dialect: Dialect::Ros2, name: "std_msgs/msg/String".into(), hash: vec![] };
    let mut roster = Outgoing::new(kind, None);
    roster.joined('a', "", RELIABLE);
    roster.announce(Instant::now(), &publisher).unwrap();
    let says_why = || lower.statuses().iter().any(|status| status.contains("the topic is of std_msgs/msg/Int32"));
    until("the other takes over", || higher.statuses() == ["up"] && says_why()).await;

    publisher.pin(ROSTER, &roster.farewell().unwrap());
    until("the lower name carries again", || stands_by(&higher) && lower.statuses() == ["up"]).await;
}

/// Each site is joined to each other by way of the switch.
#[tokio::test(flavor = "multi_thread")]
async fn three_sites_that_all_say_and_hear_a_topic_hear_each_message_once() {
    let site = Site::start().await;
    let ids = [(); 3].map(|()| lease());
    let topics = [site.topic("/chatter", "std_msgs/msg/String")];
    let _proxies = ids.map(|id| site.proxy(&id.to_string(), &domain(id), &topics, "direction: both"));
    let mut ends = ids.map(End::join);
    warm_up(&mut ends).await;
    each_is_heard_once(&mut ends).await;
    for end in ends {
        end.domain.leave().await;
    }
}

/// A node that says and hears.
struct End {
    domain: Domain,
    writer: RawWriter,
    reader: RawReader,
    /// How often each message was heard.
    heard: BTreeMap<String, usize>,
}

impl End {
    fn join(id: u16) -> Self {
        let domain = Domain::join(id, "node").unwrap();
        let writer = domain.writer(&topic("/chatter"), &string(), &RELIABLE).unwrap();
        let reader = domain.reader(&topic("/chatter"), &string(), &RELIABLE).unwrap();
        Self { domain, writer, reader, heard: BTreeMap::new() }
    }

    async fn say(&mut self, text: &str) {
        self.writer.write(cdr(text), 0).await.unwrap();
    }

    /// What comes for a while.
    async fn listen(&mut self, time: Duration) {
        let over = tokio::time::Instant::now() + time;
        while let Ok(arrived) = tokio::time::timeout_at(over, self.reader.recv()).await {
            *self.heard.entry(text(&arrived.unwrap().sample.bytes).to_owned()).or_default() += 1;
        }
    }

    /// Whether a message of a warm-up of this end was heard.
    fn has_heard(&self, from: usize) -> bool {
        self.heard.keys().any(|text| text.starts_with(&format!("warm {from} ")))
    }
}

fn stands_by(proxy: &Proxy) -> bool {
    let statuses = proxy.statuses();
    !statuses.is_empty() && statuses.iter().all(|status| status.starts_with("standing by for "))
}

/// Until each hears each other, and what was said on the way has come.
async fn warm_up(ends: &mut [End]) {
    let count = ends.len();
    let deadline = Instant::now() + TIMEOUT;
    for round in 0.. {
        for (i, end) in ends.iter_mut().enumerate() {
            end.say(&format!("warm {i} {round}")).await;
        }
        for end in ends.iter_mut() {
            end.listen(Duration::from_millis(200)).await;
        }
        let missing: Vec<_> = (0..count)
            .flat_map(|to| (0..count).map(move |from| (from, to)))
            .filter(|(from, to)| from != to && !ends[*to].has_heard(*from))
            .collect();
        if missing.is_empty() {
            break;
        }
        assert!(Instant::now() < deadline, "not heard in {TIMEOUT:?}, from and to: {missing:?}");
    }
    for end in ends {
        while !end.heard.is_empty() {
            end.heard.clear();
            end.listen(Duration::from_millis(500)).await;
        }
    }
}

/// What this process itself writes is not heard by its own readers, so a node hears all others and
/// would hear an echo of itself.
async fn each_is_heard_once(ends: &mut [End]) {
    const EACH: usize = 10;
    for round in 0..EACH {
        for (i, end) in ends.iter_mut().enumerate() {
            end.say(&format!("{i} {round}")).await;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let count = ends.len();
    for (i, end) in ends.iter_mut().enumerate() {
        within("all of the others", async {
            while end.heard.len() < (count - 1) * EACH {
                end.listen(Duration::from_millis(100)).await;
            }
        })
        .await;
        // A second copy would be here by now.
        end.listen(Duration::from_secs(1)).await;
        let again: Vec<_> = end.heard.iter().filter(|(_, times)| **times != 1).collect();
        assert!(again.is_empty() && end.heard.len() == (count - 1) * EACH, "{i}: {again:?}");
    }
}
