//! Maps the options of a topic to those of its publisher and its subscription in the fabric.

use gdp::unstable::{PublishOptions, SubscribeOptions, Wants};
use gdp_ros::qos_mapping;
use gdp_ros::roster::Offer;

use crate::config::TopicConfig;
use crate::ros2;

/// Returns the options of a fabric publisher for local publishers that offer at most `offers`.
pub fn publish_options(offers: &Offer, topic: &TopicConfig) -> PublishOptions {
    let options = qos_mapping::publish_options(offers);
    PublishOptions { class: topic.priority.get(), duplicate: topic.duplicate, ..options }
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

#[cfg(test)]
#[path = "../tests/unit/qos_mapping.rs"]
mod tests;
