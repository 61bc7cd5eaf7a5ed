//! Large messages on a path that is slower than their publisher.

use gdp_faults::Faults;

use super::simulation::*;
use super::*;

/// Publishes for 20 s what needs three times the path. Returns the delivered messages, their median
/// and longest latencies, and the evicted messages.
fn on_a_narrow_path(bytes: usize, hz: u64, keep_last: usize, rtt: u64, loss: f64) -> (u64, u64, u64, u64) {
    let mut sim = Simulation::new(8);
    let [a, b] = [(); 2].map(|()| sim.node());
    let narrow = Faults { rate: Some(40 * MBIT), queue: Some(250_000), loss, ..Faults::delay(rtt / 2) };
    sim.join(a, b, narrow, Faults::delay(rtt / 2));
    let reliability = Reliability::Reliable { overflow: Overflow::DropOldest { keep_last } };
    let history = History { messages: 10_000, bytes: 256 << 20 };
    let topic = sim.publish(
        a,
        TopicOptions { reliability, history, ..TopicOptions::reliable() },
        App::new(bytes, hz, 20 * SECOND),
    );
    sim.subscribe(b, topic, rtt, InboundOptions::every());
    sim.run(20 * SECOND);
    let latencies = sim.latencies(topic, b);
    let delivered = sim.topics[topic].readers[&b].delivered.len() as u64;
    let [median, longest] = [50, 100].map(|percent| percentile(&latencies, percent));
    (delivered, median, longest, sim.topic_counters(topic).evicted)
}

#[test]
fn a_narrow_path_carries_what_is_not_stale() {
    for (rtt, loss) in [(4 * MS, 0.0), (4 * MS, 0.01), (100 * MS, 0.0), (200 * MS, 0.01)] {
        let (delivered, median, longest, evicted) = on_a_narrow_path(500_000, 30, 5, rtt, loss);
        let (all, ..) = on_a_narrow_path(500_000, 30, 10_000, rtt, loss);
        let case = format!("{} ms, {loss}: {delivered} of {all}, {evicted}", rtt / MS);
        // A message that began is completed, so none of the path is wasted.
        assert!(delivered * 10 >= all * 9, "{case}");
        assert!(median < 1_300 * MS && longest < 4 * SECOND, "{case}, {} and {} ms", median / MS, longest / MS);
        assert!(evicted > 300, "{case}");
    }
}

#[test]
fn what_the_publisher_keeps_is_never_stale() {
    let (delivered, _, longest, evicted) = on_a_narrow_path(500_000, 30, 10_000, 4 * MS, 0.01);
    assert!(delivered > 100 && longest > 5 * SECOND && evicted == 0, "{delivered}, {} ms, {evicted}", longest / MS);
}

#[test]
fn small_messages_are_never_stale() {
    let (delivered, _, longest, evicted) = on_a_narrow_path(50_000, 300, 5, 4 * MS, 0.0);
    assert!(delivered > 1_000 && longest > 5 * SECOND && evicted == 0, "{delivered}, {} ms, {evicted}", longest / MS);
}
