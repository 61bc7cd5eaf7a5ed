//! Options of topics in tests.

use std::time::Duration;

use gdp::unstable::{PublishOptions, Reliability, SubscribeOptions};

/// Returns best-effort options for tests in which every message must arrive because nothing is
/// lost. The lifetime is long enough for a busy machine.
pub fn patient() -> (PublishOptions, SubscribeOptions) {
    const LIFETIME: Duration = Duration::from_secs(20);
    let reliability = Reliability::BestEffort { lifetime: LIFETIME };
    let mut reading = SubscribeOptions::best_effort();
    reading.limits.deadline = LIFETIME;
    (PublishOptions { reliability, ..PublishOptions::best_effort() }, reading)
}
