//! A topic's quality of service as the fabric takes it: what the name's publisher keeps, and what its reader waits for.

use gdp::node::{Overflow, PublishOptions, Reliability, SubscribeOptions, Wants};

use crate::config::TopicConfig;
use crate::ros2;
use gdp_ros::roster::Offer;

/// Messages of a reliable topic that a remote reader may ask for again, whatever the depth. ROS 2's usual depth of 10 is meant for one
/// machine; over a network, more is under way before a gap is noticed.
const REPAIRABLE: usize = 256;

/// Messages of a publisher that keeps all.
const ALL: usize = 10_000;

/// For publishers of which each offers no more than this. A reliable topic drops its oldest message rather than wait for room, as a
/// keep-last history does: a reader that fell behind holds up neither the ROS nodes nor the other readers. What is latched is said of each
/// publisher ([`latched`]).
pub fn publish_options(offers: &Offer, topic: &TopicConfig) -> PublishOptions {
    let depth = depth(offers);
    let options = if offers.reliable {
        PublishOptions {
            reliability: Reliability::Reliable { overflow: Overflow::DropOldest },
            history: depth.max(REPAIRABLE),
            ..PublishOptions::reliable()
        }
    } else {
        PublishOptions { history: depth, ..PublishOptions::best_effort() }
    };
    PublishOptions { class: topic.priority.get(), duplicate: topic.duplicate, ..options }
}

/// How many of a publisher's last messages those get who come later.
pub fn latched(offers: &Offer) -> usize {
    if offers.transient_local { depth(offers) } else { 0 }
}

/// Whether a name that is published for the one offers less than the other needs.
pub fn lacks(published: &Offer, offers: &Offer) -> bool {
    let history = |offers: &Offer| if offers.reliable { depth(offers).max(REPAIRABLE) } else { depth(offers) };
    (offers.reliable && !published.reliable) || history(offers) > history(published)
}

fn depth(offers: &Offer) -> usize {
    match offers.depth {
        0 => ALL,
        depth => ALL.min(depth as usize),
    }
}

pub fn subscribe_options(topic: &TopicConfig) -> SubscribeOptions {
    let wants = topic.qos.map_or(Wants::Offered, |qos| match qos.reliability {
        ros2::Reliability::BestEffort => Wants::Newest,
        ros2::Reliability::Reliable => Wants::Every,
    });
    let options = match wants {
        Wants::Newest => SubscribeOptions::best_effort(),
        Wants::Every => SubscribeOptions::reliable(),
        Wants::Offered => SubscribeOptions::as_offered(),
    };
    let depth = topic.qos.map_or(0, |qos| qos.depth.get().into());
    SubscribeOptions { queue: options.queue.max(depth), duplicate: topic.duplicate, ..options }
}

/// What offers as much as both.
pub fn stronger(a: Offer, b: Offer) -> Offer {
    let depth = if a.depth == 0 || b.depth == 0 { 0 } else { a.depth.max(b.depth) };
    Offer {
        reliable: a.reliable || b.reliable,
        transient_local: a.transient_local || b.transient_local,
        depth,
        deadline_ns: 0,
        lifespan_ns: 0,
        liveliness_ns: 0,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::Config;

    const BEST_EFFORT: Offer =
        Offer { reliable: false, transient_local: false, depth: 3, deadline_ns: 0, lifespan_ns: 0, liveliness_ns: 0 };

    #[test]
    fn best_effort_keeps_the_depth_and_asks_for_nothing_again() {
        let publish = publish_options(&BEST_EFFORT, &topic(""));
        assert!(matches!(publish.reliability, Reliability::BestEffort { .. }));
        assert_eq!((publish.history, publish.latched, publish.class), (3, 0, 3));
        assert_eq!(subscribe_options(&topic("qos: {reliability: best_effort}, ")).wants, Wants::Newest);
    }

    #[test]
    fn reliable_repairs_what_was_sent_lately_and_never_waits() {
        for (depth, history) in [(10, REPAIRABLE), (5000, 5000), (0, ALL)] {
            let publish = publish_options(&Offer { reliable: true, depth, ..BEST_EFFORT }, &topic("priority: 7, "));
            assert_eq!(publish.reliability, Reliability::Reliable { overflow: Overflow::DropOldest });
            assert_eq!((publish.history, publish.latched, publish.class), (history, 0, 7));
        }
        let subscribe = subscribe_options(&topic("qos: {depth: 5000}, "));
        assert_eq!((subscribe.wants, subscribe.queue), (Wants::Every, 5000));
        assert_eq!(subscribe_options(&topic("")).wants, Wants::Offered);
    }

    #[test]
    fn transient_local_gives_late_readers_the_depth() {
        let latching = Offer { transient_local: true, depth: 7, ..BEST_EFFORT };
        assert_eq!((latched(&latching), latched(&BEST_EFFORT)), (7, 0));
        assert_eq!(publish_options(&latching, &topic("")).latched, 0, "it is nobody else's");
    }

    #[test]
    fn a_name_is_published_anew_only_for_what_it_lacks() {
        let reliable = Offer { reliable: true, depth: 10, ..BEST_EFFORT };
        let latching = Offer { transient_local: true, depth: 1, ..reliable };
        assert!(!lacks(&reliable, &latching) && !lacks(&latching, &reliable) && !lacks(&reliable, &BEST_EFFORT));
        assert!(lacks(&BEST_EFFORT, &reliable) && lacks(&reliable, &Offer { depth: 0, ..reliable }));
    }

    #[test]
    fn of_several_publishers_the_most_is_taken() {
        let latched = Offer { transient_local: true, depth: 1, ..BEST_EFFORT };
        let reliable = Offer { reliable: true, depth: 0, ..BEST_EFFORT };
        let all = stronger(stronger(latched, reliable), BEST_EFFORT);
        assert_eq!((all.reliable, all.transient_local, all.depth), (true, true, 0));
        assert_eq!(stronger(latched, BEST_EFFORT).depth, 3);
    }

    fn topic(extra: &str) -> TopicConfig {
        let text = format!(
            "{{version: 1, identity: i, links: [{{to: 'eth://r0'}}], \
             topics: [{{topic: /a, {extra}direction: out, card: c, cert: d}}]}}"
        );
        Config::parse(&text, Path::new("p.yaml")).unwrap().topics.remove(0)
    }
}
