//! Maps the quality of service of a topic to the fabric: the history of the name's publisher, and
//! the delivery that its reader waits for.

use gdp::{Overflow, PublishOptions, Reliability, SubscribeOptions, Wants};

use crate::config::TopicConfig;
use crate::ros2;
use gdp_ros::roster::Offer;

/// Messages of a reliable topic that a remote reader may request again, whatever the depth. The
/// usual depth of 10 in ROS 2 is meant for one machine. Over a network, more messages are in flight
/// before the reader notices a gap.
const REPAIRABLE: usize = 256;

/// Bound in messages on the history of a publisher with keep-all history.
const ALL: usize = 10_000;

/// Returns the options of a fabric publisher for local publishers that offer at most `offers`. A
/// reliable topic drops its oldest message instead of waiting for room, as a keep-last history
/// does. So a reader that falls behind delays neither the ROS nodes nor the other readers.
/// [`latched`] gives the transient-local depth of each publisher.
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

/// Returns how many of the publisher's last messages late subscribers get.
pub fn latched(offers: &Offer) -> usize {
    if offers.transient_local { depth(offers) } else { 0 }
}

/// Whether a name published with the options of `published` offers less than `offers` needs.
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

/// Returns the weakest offer that is at least as strong as both.
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
