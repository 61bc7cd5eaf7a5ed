//! Options of topics for tests.

use std::time::Duration;

use gdp::{PublishOptions, Reliability, SubscribeOptions};

/// Of best effort, where each message is to arrive as nothing loses any: for as long as that takes
/// on a machine that is busy.
pub fn patient() -> (PublishOptions, SubscribeOptions) {
    const LIFETIME: Duration = Duration::from_secs(20);
    let reliability = Reliability::BestEffort { lifetime: LIFETIME };
    let mut reading = SubscribeOptions::best_effort();
    reading.limits.deadline = LIFETIME;
    (PublishOptions { reliability, ..PublishOptions::best_effort() }, reading)
}
