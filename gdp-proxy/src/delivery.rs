//! A topic's quality of service as the fabric takes it: what the name's publisher keeps, and what its reader waits for.

use gdp::node::{Overflow, PublishOptions, Reliability, SubscribeOptions};

use crate::ros2::{self, Durability, Qos};

/// Messages of a reliable topic that a remote reader may ask for again, whatever the depth. ROS 2's usual depth of 10 is meant for one
/// machine; over a network, more is under way before a gap is noticed.
const REPAIRABLE: usize = 256;

/// A reliable topic drops its oldest message rather than wait for room, as a keep-last history does: a reader that fell behind
/// holds up neither the ROS node nor the other readers.
///
/// `duplicate`: it goes by two links.
pub fn publish_options(qos: &Qos, duplicate: bool) -> PublishOptions {
    let depth = usize::from(qos.depth.get());
    let latched = match qos.durability {
        Durability::Volatile => 0,
        Durability::TransientLocal => depth,
    };
    let options = match qos.reliability {
        ros2::Reliability::BestEffort => PublishOptions { history: depth, ..PublishOptions::best_effort() },
        ros2::Reliability::Reliable => PublishOptions {
            reliability: Reliability::Reliable { overflow: Overflow::DropOldest },
            history: depth.max(REPAIRABLE),
            ..PublishOptions::reliable()
        },
    };
    PublishOptions { latched, duplicate, ..options }
}

pub fn subscribe_options(qos: &Qos, duplicate: bool) -> SubscribeOptions {
    let options = match qos.reliability {
        ros2::Reliability::BestEffort => SubscribeOptions::best_effort(),
        ros2::Reliability::Reliable => SubscribeOptions::reliable(),
    };
    SubscribeOptions { queue: options.queue.max(qos.depth.get().into()), duplicate, ..options }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros2::Depth;

    #[test]
    fn best_effort_keeps_the_depth_and_asks_for_nothing_again() {
        let qos = qos(ros2::Reliability::BestEffort, Durability::Volatile, 3);
        let publish = publish_options(&qos, false);
        assert!(matches!(publish.reliability, Reliability::BestEffort { .. }));
        assert_eq!((publish.history, publish.latched), (3, 0));
        assert!(!subscribe_options(&qos, false).reliable);
    }

    #[test]
    fn reliable_repairs_what_was_sent_lately_and_never_waits() {
        for (depth, history) in [(10, REPAIRABLE), (5000, 5000)] {
            let qos = qos(ros2::Reliability::Reliable, Durability::Volatile, depth);
            let publish = publish_options(&qos, false);
            assert_eq!(publish.reliability, Reliability::Reliable { overflow: Overflow::DropOldest });
            assert_eq!((publish.history, publish.latched), (history, 0));
            let subscribe = subscribe_options(&qos, false);
            assert!(subscribe.reliable && subscribe.queue >= depth as usize);
        }
    }

    #[test]
    fn transient_local_gives_late_readers_the_depth() {
        for reliability in [ros2::Reliability::BestEffort, ros2::Reliability::Reliable] {
            assert_eq!(publish_options(&qos(reliability, Durability::TransientLocal, 7), true).latched, 7);
        }
    }

    fn qos(reliability: ros2::Reliability, durability: Durability, depth: u64) -> Qos {
        Qos { reliability, durability, depth: Depth::try_from(depth).unwrap() }
    }
}
