//! Maps the quality of service that ROS publishers offer to the history of the name's publisher in
//! the fabric.

use gdp::unstable::{Overflow, PublishOptions, Reliability};

use crate::roster::Offer;

/// Messages of a reliable topic that a remote reader may request again, whatever the depth. The
/// usual depth of 10 in ROS 2 is meant for one machine. Over a network, more messages are in flight
/// before the reader notices a gap.
const REPAIRABLE: usize = 256;

/// Bound in messages on the history of a publisher with keep-all history.
const ALL: usize = 10_000;

/// Returns the options of a fabric publisher for ROS publishers that offer at most `offers`. A
/// reliable topic drops its oldest message instead of waiting for room, as a keep-last history
/// does. So a reader that falls behind delays neither the ROS nodes nor the other readers. A large
/// message that the depth would have dropped gives way after a second.
/// [`latched_depth`] gives the transient-local depth of each publisher.
pub fn publish_options(offers: &Offer) -> PublishOptions {
    let depth = depth(offers);
    if offers.reliable {
        PublishOptions {
            reliability: Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: depth } },
            history: depth.max(REPAIRABLE),
            ..PublishOptions::reliable()
        }
    } else {
        PublishOptions { history: depth, ..PublishOptions::best_effort() }
    }
}

/// Returns how many of the publisher's last messages late subscribers get.
pub fn latched_depth(offers: &Offer) -> usize {
    if offers.transient_local { depth(offers) } else { 0 }
}

/// Returns whether `offers` needs more than a name that was published for `published` has. How much
/// a publisher latches can change while the name is published. For stale messages, a depth below
/// [`REPAIRABLE`] counts as it was when the name was published.
pub fn exceeds(offers: &Offer, published: &Offer) -> bool {
    let history = |offers: &Offer| if offers.reliable { depth(offers).max(REPAIRABLE) } else { depth(offers) };
    let is_deeper = !offers.transient_local && history(offers) > history(published);
    (offers.reliable && !published.reliable) || is_deeper
}

/// Returns the weakest offer that is at least as strong as both.
pub fn merged(a: Offer, b: Offer) -> Offer {
    let depth = if a.depth == 0 || b.depth == 0 { 0 } else { a.depth.max(b.depth) };
    Offer {
        reliable: a.reliable || b.reliable,
        transient_local: a.transient_local || b.transient_local,
        depth,
        deadline_ns: 0,
        lifespan_ns: 0,
        liveliness_ns: 0,
        manual_liveliness: false,
    }
}

fn depth(offers: &Offer) -> usize {
    match offers.depth {
        0 => ALL,
        depth => ALL.min(depth as usize),
    }
}

#[cfg(test)]
#[path = "../tests/unit/qos_mapping.rs"]
mod tests;
