//! Properties under any faults. The simulation checks at every step: no duplicate messages, order,
//! exact counts and bounded memory.

use gdp_faults::{Burst, Faults, Random, Reorder};

use super::simulation::*;
use super::*;

/// Trees of switches, several writers, topics of all kinds, readers that join and leave.
#[test]
fn random_worlds() {
    for seed in 0..40 {
        let mut random = Random::new(seed);
        let mut sim = Simulation::new(seed);
        let switches: Vec<usize> = (0..=random.up_to(2)).map(|_| sim.node()).collect();
        for pair in switches.windows(2) {
            sim.join(pair[0], pair[1], faults(&mut random), faults(&mut random));
        }
        let attach = |sim: &mut Simulation, random: &mut Random| {
            let node = sim.node();
            let switch = switches[random.up_to(switches.len() as u64 - 1) as usize];
            sim.join(node, switch, faults(random), faults(random));
            node
        };
        let writers: Vec<usize> = (0..=random.up_to(1)).map(|_| attach(&mut sim, &mut random)).collect();
        let readers: Vec<usize> = (0..=random.up_to(3)).map(|_| attach(&mut sim, &mut random)).collect();
        let topics: Vec<(usize, bool)> =
            (0..=random.up_to(2)).map(|_| publish(&mut sim, &mut random, &writers)).collect();
        for second in 0..3 {
            for (topic, reliable) in &topics {
                for reader in &readers {
                    match random.up_to(5) {
                        0 if sim.topics[*topic].readers.contains_key(reader) => sim.unsubscribe(*reader, *topic),
                        0..=3 if !sim.topics[*topic].readers.contains_key(reader) => {
                            subscribe(&mut sim, *reader, *topic, *reliable)
                        }
                        _ => {}
                    }
                }
            }
            sim.run((second + 1) * SECOND);
        }
        // Faults and publishers end, so everything that can be repaired is repaired.
        sim.run(120 * SECOND);
        for (topic, reliable) in &topics {
            let sent = sim.topics[*topic].pushed.len() as u64 - 1;
            let evicted = sim.topic_counters(*topic).evicted;
            for reading in sim.topics[*topic].readers.values() {
                let counters = reading.counters();
                assert!(reading.most_memory <= 66 << 20);
                if *reliable {
                    assert_eq!(reading.next(), sent + 1, "seed {seed}: all dealt with: {counters:?}");
                    assert!(
                        counters.abandoned <= evicted && counters.overtaken + counters.expired == 0,
                        "seed {seed}: {counters:?}, {evicted}"
                    );
                }
                let budget = sim.topics[*topic].sent_bytes / 4 + 120 * (1 << 16);
                assert!(reading.feedback_bytes < budget, "seed {seed}: {} bytes of feedback", reading.feedback_bytes);
            }
        }
        assert!(sim.is_quiet(), "seed {seed}: nothing goes on without a reason");
    }
}

#[test]
fn a_reader_that_lies_is_only_a_nuisance() {
    let (mut sim, writer, readers) =
        Simulation::star(1, Faults { rate: Some(20_000_000), queue: Some(60_000), ..Faults::delay(5 * MS) }, 1);
    let topic = sim.publish(writer, TopicOptions::reliable(), App::new(20_000, 50, 3 * SECOND));
    sim.subscribe(readers[0], topic, 10 * MS, InboundOptions::every());
    let liar = name_of(77);
    let (id, now) = (sim.topics[topic].id, sim.now());
    sim.uplink(writer, None).join(now, id, liar);
    let mut random = Random::new(5);
    for step in 1..3000 {
        sim.run(step * MS);
        let lie = lie(&mut random, topic);
        let now = sim.now();
        sim.uplink(writer, None).feedback(now, id, liar, &lie);
    }
    sim.run(6 * SECOND);
    assert_eq!(sim.topics[topic].readers[&readers[0]].delivered.len(), 150, "{:?}", sim.topic_counters(topic));
    let TopicSim { sent_bytes, repeated_bytes, .. } = sim.topics[topic];
    let fresh = sent_bytes - repeated_bytes;
    assert!(repeated_bytes < fresh / 4 + 4 * (256 << 10) + (1 << 20), "{repeated_bytes} of {sent_bytes}");
}

/// A holder of the key can forge segments, but no message. The messages that the writer signs are
/// still delivered.
#[test]
fn made_up_segments_move_nothing() {
    for options in [InboundOptions::newest(), InboundOptions::every()] {
        let mut inbound = Inbound::new(name_of(0), [0; 16], 1, 10 * MS, options);
        let mut delivered = Vec::new();
        for sequence in 1..=500 {
            let now = sequence * 33 * MS;
            for made_up in [sequence + 1, sequence + 40, sequence + 5000, 1 << 47] {
                let position = Position { sequence: made_up, index: 0 };
                inbound.segment(now, &Segment { position, cut: 0, total: 700, bytes: 1400 });
            }
            inbound.complete(now, sequence, 1000, sequence);
            while let Some(arrival) = inbound.poll(now) {
                if let Arrival::Message(sequence) = arrival {
                    delivered.push(sequence);
                }
            }
            assert!(inbound.memory() < 1 << 20);
        }
        let late = 500 - delivered.len();
        assert!(delivered.is_sorted() && (late == 0 || options.order == Order::Newest), "{late} {options:?}");
        assert!(inbound.next_sequence() == 501 && inbound.counters().overtaken + inbound.counters().abandoned == 0);
    }
}

/// A large message with repairs does not delay another topic of the same link.
#[test]
fn no_topic_waits_for_the_gap_of_another() {
    let faults = Faults { loss: 0.05, rate: Some(50_000_000), queue: Some(1 << 20), ..Faults::delay(25 * MS) };
    let (mut sim, writer, readers) = Simulation::star(3, faults, 1);
    let large = sim.publish(writer, TopicOptions::reliable(), App::new(300_000, 10, 3 * SECOND));
    let small = sim.publish(writer, TopicOptions::best_effort(), App::new(64, 100, 3 * SECOND));
    sim.subscribe(readers[0], large, 50 * MS, InboundOptions::every());
    sim.subscribe(readers[0], small, 50 * MS, InboundOptions::newest());
    sim.run(5 * SECOND);
    assert_eq!(sim.topics[large].readers[&readers[0]].delivered.len(), 30);
    let latencies = sim.latencies(small, readers[0]);
    assert!(
        latencies.len() > 270 && percentile(&latencies, 90) < 75 * MS,
        "{} {}",
        latencies.len(),
        percentile(&latencies, 90) / MS
    );
}

/// Lower classes get their floor, but not more, while another topic uses the whole link.
#[test]
fn every_class_has_a_floor() {
    let (mut sim, writer, readers) = Simulation::star(4, Faults::delay(MS), 1);
    sim.uplink(writer, Some(1_000_000));
    let urgent =
        sim.publish(writer, TopicOptions { class: 7, ..TopicOptions::reliable() }, App::new(100_000, 50, 4 * SECOND));
    let calm =
        sim.publish(writer, TopicOptions { class: 0, ..TopicOptions::reliable() }, App::new(1_000, 100, 4 * SECOND));
    sim.subscribe(readers[0], urgent, 2 * MS, InboundOptions::every());
    sim.subscribe(readers[0], calm, 2 * MS, InboundOptions::every());
    sim.run(4 * SECOND);
    let (most, least) = (sim.topics[urgent].sent_bytes, sim.topics[calm].sent_bytes);
    assert!(most > 25 * least, "{most} and {least}");
    assert!(least > most / 40, "{most} and {least}");
}

fn publish(sim: &mut Simulation, random: &mut Random, writers: &[usize]) -> (usize, bool) {
    let writer = writers[random.up_to(writers.len() as u64 - 1) as usize];
    let history = History { messages: 1 + random.up_to(200) as usize, bytes: 1 << (16 + random.up_to(8)) };
    let overflow = if random.chance(0.5) { Overflow::Block } else { Overflow::DropOldest { keep_last: 10 } };
    let reliable = random.chance(0.6);
    let lifetime = (20 + random.up_to(400)) * MS;
    let reliability = if reliable { Reliability::Reliable { overflow } } else { Reliability::BestEffort { lifetime } };
    let options = TopicOptions { reliability, history, class: random.up_to(7) as u8, doubled: false };
    let size = 1 << random.up_to(17);
    let topic = sim.publish(writer, options, App::new(size, 1 + random.up_to(100), 3 * SECOND));
    (topic, reliable)
}

fn subscribe(sim: &mut Simulation, reader: usize, topic: usize, reliable: bool) {
    let patient = InboundOptions { deadline: 300 * SECOND, ..InboundOptions::every() };
    let options = if reliable { patient } else { InboundOptions::newest() };
    sim.subscribe(reader, topic, 30 * MS, options);
}

fn faults(random: &mut Random) -> Faults {
    let mut faults = Faults { delay: random.up_to(30) * MS, ..Faults::default() };
    let mut sometimes = |probability| random.chance(probability);
    let (rate, loss, burst, reorder, duplicate, corrupt, partition) = (
        sometimes(0.5),
        sometimes(0.5),
        sometimes(0.3),
        sometimes(0.3),
        sometimes(0.3),
        sometimes(0.3),
        sometimes(0.2),
    );
    if rate {
        faults.rate = Some((1 + random.up_to(100)) * 1_000_000);
        faults.queue = Some(20_000 + random.up_to(500_000));
        faults.mark_above = random.chance(0.3).then_some(15_000);
    }
    faults.loss = if loss { random.up_to(20) as f64 / 100.0 } else { 0.0 };
    faults.burst = burst.then_some(Burst { enter: 0.01, leave: 0.1, loss: 0.9 });
    faults.reorder = reorder.then_some(Reorder { probability: 0.1, by: 30 * MS });
    faults.jitter = if reorder { 10 * MS } else { 0 };
    faults.duplicate = if duplicate { 0.1 } else { 0.0 };
    faults.corrupt = if corrupt { 0.02 } else { 0.0 };
    if partition {
        faults.partitions = vec![(SECOND / 2, SECOND + random.up_to(3 * SECOND))];
    }
    faults
}

fn lie(random: &mut Random, topic: usize) -> crate::feedback_wire::Feedback {
    use crate::feedback_wire::{Feedback, MAX_MISSING, Missing};
    let (name, session) = (name_of(topic), [topic as u8; 16]);
    if random.chance(0.5) {
        let from = 1 + random.up_to(150);
        let missing = (from..from + MAX_MISSING as u64).map(Missing::whole).collect();
        return Feedback::Nack {
            name,
            session,
            highest: random.up_to(150),
            highest_index: random.up_to(30) as u32,
            waited_us: random.number() as u32,
            missing,
        };
    }
    Feedback::Report {
        name,
        session,
        highest: random.number() >> 20,
        acknowledged: random.up_to(3),
        received_segments: random.number(),
        received_bytes: random.number(),
        needless_bytes: random.number(),
        ce: random.number() as u32,
        echo: random.up_to(150),
        echo_index: random.up_to(30) as u32,
        delay_us: random.number() as u32,
    }
}
