//! The cases of the transport that have names, in simulated time.

use gdp_faults::Faults;

use super::simulation::*;
use super::*;

const RTT: u64 = 50 * MS;

#[test]
fn best_effort_over_a_perfect_link() {
    let (mut sim, writer, readers) = Simulation::star(1, Faults::delay(RTT / 2), 1);
    let topic = sim.publish(writer, TopicOptions::best_effort(), App::new(64, 100, SECOND));
    sim.subscribe(readers[0], topic, RTT, InboundOptions::newest());
    sim.run(2 * SECOND);
    assert_eq!(sim.topics[topic].readers[&readers[0]].delivered.len(), 100);
}

#[test]
fn reliable_over_a_lossy_link() {
    for seed in 0..5 {
        let faults = Faults { loss: 0.1, ..Faults::delay(RTT / 2) };
        let (mut sim, writer, readers) = Simulation::star(seed, faults, 1);
        let topic = sim.publish(writer, TopicOptions::reliable(), App::new(20_000, 20, SECOND));
        sim.subscribe(readers[0], topic, RTT, InboundOptions::every());
        sim.run(4 * SECOND);
        let reading = &sim.topics[topic].readers[&readers[0]];
        assert_eq!(reading.delivered.len(), 20, "{:?} {:?}", reading.counters(), sim.topic_counters(topic));
    }
}
