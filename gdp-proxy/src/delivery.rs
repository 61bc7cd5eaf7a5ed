//! Maps the quality of service of a topic to the fabric: the history of the name's publisher, and
//! the delivery that its reader waits for.

use gdp::{Overflow, PublishOptions, Reliability, SubscribeOptions, Wants};

use crate::config::TopicConfig;
use crate::ros2;
use gdp_ros::roster::Offer;

/// Messages of a reliable topic that a remote reader may ask for again, whatever the depth. ROS 2's
/// usual depth of 10 is meant for one machine; over a network, more is under way before a gap is
/// noticed.
const REPAIRABLE: usize = 256;

/// Messages of a publisher that keeps all.
const ALL: usize = 10_000;

/// For publishers of which each offers no more than this. A reliable topic drops its oldest message
/// rather than wait for room, as a keep-last history does: a reader that fell behind holds up
/// neither the ROS nodes nor the other readers. What is latched is said of each publisher
/// ([`latched`]).
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
#[path = "../tests/unit/delivery.rs"]
mod tests;
