//! Actions at a ROS 1 master. Each consists of five topics, which this module recognises.

use std::time::Duration;

use gdp_ros::actionlib::message::Time;
use gdp_ros1::{Message, Snapshot, Subscription};
use gdp_util::unix_time::unix_nanos;
use tokio::sync::Mutex;
use tokio::time::{Interval, MissedTickBehavior};

use super::is_proxy;
use crate::config::action_type;
use crate::ros2::TypeName;

/// Returns all actions that a node serves, with their types. Proxies are left out, because they
/// stand for remote servers.
pub fn all(there: &Snapshot) -> impl Iterator<Item = (&str, TypeName)> {
    let actions = there.topics.keys().filter_map(|name| name.strip_suffix("/goal"));
    let served = actions.filter(|action| servers(there, action).next().is_some());
    served.filter_map(|action| Some((action, kind(there, action)?)))
}

/// Returns the nodes that serve an action: they publish its status and subscribe to its goals.
pub fn servers<'a>(there: &'a Snapshot, action: &str) -> impl Iterator<Item = &'a String> + use<'a> {
    let topic = |part: &str| there.topics.get(&format!("{action}/{part}"));
    let both = topic("status").zip(topic("goal"));
    let nodes = both.into_iter().flat_map(|(status, goal)| status.publishers.intersection(&goal.subscribers));
    nodes.filter(|node| !is_proxy(node))
}

/// Returns the type of an action as ROS 2 writes it, from the type of its goals.
pub fn kind(there: &Snapshot, action: &str) -> Option<TypeName> {
    let goal = there.topics.get(&format!("{action}/goal"))?.kind.as_ref()?;
    action_type(&TypeName::parse(&goal.replacen('/', "/msg/", 1)).ok()?)
}

/// Waits for the next message of a topic, or forever once the node has left. Safe to cancel.
pub async fn next(subscription: &Mutex<Subscription>) -> Message {
    match subscription.lock().await.next().await {
        Some(message) => message,
        None => std::future::pending().await,
    }
}

/// Returns the present time as ROS 1 writes it.
pub fn now() -> Time {
    let nanoseconds = unix_nanos();
    ((nanoseconds / 1_000_000_000) as u32, (nanoseconds % 1_000_000_000) as u32)
}

/// A clock that can be awaited by reference. Safe to cancel.
pub struct Ticks(Mutex<Interval>);

impl Ticks {
    pub fn every(period: Duration) -> Self {
        let mut interval = tokio::time::interval(period);
        interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Self(Mutex::new(interval))
    }

    pub async fn next(&self) {
        self.0.lock().await.tick().await;
    }
}
