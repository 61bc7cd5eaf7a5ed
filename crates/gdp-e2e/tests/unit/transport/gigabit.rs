//! Large messages on a local path that is slower than the host, through a switch with a short
//! queue.

use gdp_faults::Faults;

use super::simulation::*;
use super::*;

/// Publishes 6 MB at 10 Hz for 6 s, half of what 1 Gb/s carries. Returns the latencies, and the
/// share of bytes that were sent again.
fn point_clouds(rtt: u64, queue: u64, writer: Option<Away>) -> (Vec<u64>, f64) {
    let mut sim = Simulation::new(20);
    let [a, b] = [(); 2].map(|()| sim.node());
    let link = Faults { rate: Some(1000 * MBIT), queue: Some(queue), ..Faults::delay(rtt / 2) };
    sim.join(a, b, link, Faults::delay(rtt / 2));
    if let Some(away) = writer {
        sim.take_away(a, away);
    }
    let reliability = Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: 5 } };
    let history = History { messages: 10_000, bytes: 256 << 20 };
    let topic = sim.publish(
        a,
        TopicOptions { reliability, history, ..TopicOptions::reliable() },
        App::new(6_000_000, 10, 6 * SECOND),
    );
    sim.subscribe(b, topic, rtt, InboundOptions::every());
    sim.run(8 * SECOND);
    let TopicSim { repeated_bytes, sent_bytes, .. } = &sim.topics[topic];
    let repeated = *repeated_bytes as f64 / *sent_bytes as f64;
    (sim.latencies(topic, b), repeated)
}

/// The first message overruns the queue. Its repairs do not wait for the next one.
#[test]
fn a_short_queue_is_overrun_once() {
    for rtt in [MS / 5, 2 * MS] {
        for queue in [128_000, 256_000, 500_000, 1_000_000] {
            let (latencies, repeated) = point_clouds(rtt, queue, None);
            let [median, longest] = [50, 100].map(|percent| percentile(&latencies, percent) / MS);
            let case = format!("{rtt} ns, {queue} B: {median} and {longest} ms, {repeated}");
            // The path takes 51 ms for a message.
            assert!(latencies.len() == 60 && median < 60 && longest < 400 && repeated < 0.01, "{case}");
        }
    }
}

/// What a thread did not send while it had no processor would overrun the queue again and again.
#[test]
fn a_late_writer_does_not_overrun_a_short_queue() {
    for queue in [128_000, 256_000] {
        let away = Away { period: 8 * MS, away: 3 * MS, since: 0 };
        let (latencies, repeated) = point_clouds(MS / 5, queue, Some(away));
        let [median, longest] = [50, 100].map(|percent| percentile(&latencies, percent) / MS);
        let case = format!("{queue} B: {} of 60, {median} and {longest} ms, {repeated}", latencies.len());
        assert!(latencies.len() == 60 && median < 100 && longest < 900 && repeated < 0.03, "{case}");
    }
}
