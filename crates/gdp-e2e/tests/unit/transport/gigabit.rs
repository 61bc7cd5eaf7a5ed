//! Large messages on a local path that is slower than the host, through a switch with a short
//! queue.

use gdp_faults::Faults;

use super::simulation::*;
use super::*;

/// Publishes 6 MB at 10 Hz for 6 s, half of what 1 Gb/s carries. Returns the latencies, and the
/// bytes that were sent again, in percent.
fn point_clouds(rtt: u64, queue: u64) -> (Vec<u64>, u64) {
    let mut sim = Simulation::new(20);
    let [a, b] = [(); 2].map(|()| sim.node());
    let link = Faults { rate: Some(1000 * MBIT), queue: Some(queue), ..Faults::delay(rtt / 2) };
    sim.join(a, b, link, Faults::delay(rtt / 2));
    let reliability = Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: 5 } };
    let history = History { messages: 10_000, bytes: 256 << 20 };
    let topic = sim.publish(
        a,
        TopicOptions { reliability, history, ..TopicOptions::reliable() },
        App::new(6_000_000, 10, 6 * SECOND),
    );
    sim.subscribe(b, topic, rtt, InboundOptions::every());
    sim.run(8 * SECOND);
    (sim.latencies(topic, b), 100 * sim.topics[topic].repeated_bytes / sim.topics[topic].sent_bytes)
}

/// The first message overruns the queue. Its repairs do not wait for the next one.
#[test]
fn a_short_queue_is_overrun_once() {
    for rtt in [MS / 5, 2 * MS] {
        for queue in [128_000, 256_000, 500_000, 1_000_000] {
            let (latencies, repeated) = point_clouds(rtt, queue);
            let [median, longest] = [50, 100].map(|percent| percentile(&latencies, percent) / MS);
            let case = format!("{rtt} ns, {queue} B: {median} and {longest} ms, {repeated} %");
            // The path takes 51 ms for a message.
            assert!(latencies.len() == 60 && median < 60 && longest < 400 && repeated == 0, "{case}");
        }
    }
}
