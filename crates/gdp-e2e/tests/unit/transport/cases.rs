//! Named cases of the transport, in simulated time.

use gdp_faults::{Burst, Faults, Reorder};

use super::simulation::*;
use super::*;

const RTT: u64 = 50 * MS;

/// Uses a link of 200 Mb/s.
#[test]
fn reliable_1_mb_at_10_hz_over_1_percent_loss_and_50_ms() {
    const RATE: u64 = 200 * MBIT;
    for seed in 0..2 {
        let faults = Faults { rate: Some(RATE), queue: Some(2 << 20), loss: 0.01, ..Faults::delay(RTT / 2) };
        let (mut sim, writer, readers) = Simulation::star(seed, faults, 1);
        let topic = sim.publish(writer, TopicOptions::reliable(), App::new(1_000_000, 10, 15 * SECOND));
        sim.subscribe(readers[0], topic, RTT, InboundOptions::every());
        sim.run(17 * SECOND);
        let reading = &sim.topics[topic].readers[&readers[0]];
        assert_eq!(reading.delivered.len(), 150);
        let serialization = 1_070_000 * 8 * SECOND / RATE;
        let p99 = percentile(&sim.latencies(topic, readers[0]), 99);
        assert!(p99 <= 4 * RTT + serialization, "{} ms", p99 / MS);
        assert!(reading.feedback_bytes * 100 < sim.topics[topic].sent_bytes, "{} bytes", reading.feedback_bytes);
    }
}

#[test]
fn reliable_64_b_at_1_khz_over_10_percent_loss_reordering_and_duplication() {
    for seed in 0..4 {
        let reorder = Some(Reorder { probability: 0.1, by: 20 * MS });
        let faults = Faults { loss: 0.1, duplicate: 0.05, reorder, ..Faults::delay(RTT / 2) };
        let (mut sim, writer, readers) = Simulation::star(seed, faults, 1);
        let topic = sim.publish(writer, TopicOptions::reliable(), App::new(64, 1000, 5 * SECOND));
        sim.subscribe(readers[0], topic, RTT, InboundOptions::every());
        sim.run(9 * SECOND);
        let reading = &sim.topics[topic].readers[&readers[0]];
        let delivered: Vec<u64> = reading.delivered.iter().map(|(sequence, _)| *sequence).collect();
        assert_eq!(delivered, (1..=5000).collect::<Vec<_>>(), "every message once, in order");
    }
}

#[test]
fn best_effort_1_mb_at_30_hz_over_2_percent_loss() {
    let lifetime = 200 * MS;
    for seed in 0..2 {
        let faults = Faults { rate: Some(1000 * MBIT), queue: Some(4 << 20), loss: 0.02, ..Faults::delay(RTT / 2) };
        let (mut sim, writer, readers) = Simulation::star(seed, faults, 1);
        let topic = sim.publish(writer, TopicOptions::best_effort(), App::new(1_000_000, 30, 4 * SECOND));
        sim.subscribe(readers[0], topic, RTT, InboundOptions::newest());
        sim.run(5 * SECOND);
        let reading = &sim.topics[topic].readers[&readers[0]];
        let counters = reading.counters();
        let latencies = sim.latencies(topic, readers[0]);
        assert!(*latencies.last().unwrap() <= lifetime + RTT / 2 + MS, "none later than its deadline");
        let times: Vec<u64> = reading.delivered.iter().map(|(_, at)| *at).collect();
        let stall = times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
        assert!(stall < 500 * MS, "no stall: {} ms", stall / MS);
        assert!(counters.delivered > 80, "{counters:?}");
        // Each message is counted once, in one of the counters.
        let dealt = counters.delivered + counters.overtaken + counters.expired + counters.abandoned;
        assert_eq!(dealt, reading.next() - 1);
        assert!(dealt >= 120 - 1, "{dealt}");
    }
}

/// With the link's rate as the uplink's budget, and without. In the second case, only the large
/// topic's path limits the queue. Frames of 9000 bytes make the ten seconds fast to simulate.
#[test]
fn small_10_mb_at_10_hz_and_64_b_at_100_hz_on_one_500_mbit_link() {
    const RATE: u64 = 500 * MBIT;
    const LARGE_PAYLOAD: usize = 8900;
    let mtu = (LARGE_PAYLOAD as u64 + FRAME_HEADER) * 8 * SECOND / RATE;
    for (delay, budget) in [(MS, Some(RATE / 8)), (MS, None)] {
        let small_p99 = |seed, with_large: bool| {
            let faults = Faults { rate: Some(RATE), queue: Some(4 << 20), ..Faults::delay(delay) };
            let (mut sim, writer, readers) = Simulation::star(seed, faults, 1);
            sim.max_payload = LARGE_PAYLOAD;
            sim.uplink(writer, budget);
            let options = TopicOptions { class: 6, ..TopicOptions::reliable() };
            let small = sim.publish(writer, options, App::new(64, 100, 10 * SECOND));
            sim.subscribe(readers[0], small, 2 * delay, InboundOptions::every());
            if with_large {
                let large = sim.publish(writer, large_options(), App::new(10_000_000, 10, 10 * SECOND));
                let options = InboundOptions { deadline: LIFETIME, ..InboundOptions::newest() };
                sim.subscribe(readers[0], large, 2 * delay, options);
                sim.run(11 * SECOND);
                // The link carries almost six of the messages a second, so about every second one
                // is sent.
                let counters = sim.topics[large].readers[&readers[0]].counters();
                assert!(counters.delivered >= 50, "{counters:?}");
            }
            sim.run(11 * SECOND);
            assert_eq!(sim.topics[small].readers[&readers[0]].delivered.len(), 1000);
            percentile(&sim.latencies(small, readers[0]), 99)
        };
        let (idle, beside) = (small_p99(1, false), small_p99(2, true));
        assert!(beside <= 2 * idle + mtu, "{beside} ns beside, {idle} ns idle, budget {budget:?}");
    }
}

/// Lifetime of the large messages, each of which occupies the link for 171 ms.
const LIFETIME: u64 = 400 * MS;

fn large_options() -> TopicOptions {
    let history = History { messages: 1, bytes: 64 << 20 };
    TopicOptions { reliability: Reliability::BestEffort { lifetime: LIFETIME }, history, ..TopicOptions::best_effort() }
}

#[test]
fn link_down_3_s_and_back() {
    for seed in 0..3 {
        let faults = Faults { partitions: vec![(2 * SECOND, 5 * SECOND)], loss: 0.01, ..Faults::delay(RTT / 2) };
        let (mut sim, writer, readers) = Simulation::star(seed, faults, 1);
        let history = |messages| History { messages, bytes: 64 << 20 };
        let overflow = Overflow::DropOldest { keep_last: 10 };
        let reliability = Reliability::Reliable { overflow };
        let covered = TopicOptions { history: history(1000), ..TopicOptions::reliable() };
        let short = TopicOptions { history: history(100), reliability, ..TopicOptions::reliable() };
        let covered = sim.publish(writer, covered, App::new(1000, 100, 8 * SECOND));
        let short = sim.publish(writer, short, App::new(1000, 100, 8 * SECOND));
        sim.subscribe(readers[0], covered, RTT, InboundOptions::every());
        sim.subscribe(readers[0], short, RTT, InboundOptions::every());

        sim.run(10 * SECOND);
        let reading = |topic: usize| &sim.topics[topic].readers[&readers[0]];
        assert_eq!(reading(covered).delivered.len(), 800, "{:?}", sim.topic_counters(covered));
        assert_eq!(sim.topic_counters(covered).evicted, 0);
        let counters = reading(short).counters();
        assert_eq!(counters.delivered + counters.abandoned, 800);
        assert!((150..260).contains(&counters.abandoned), "{counters:?}");
        assert!(sim.topic_counters(short).evicted >= counters.abandoned);
    }
}

#[test]
fn the_last_message_before_a_partition_comes_after_it() {
    let faults = Faults { partitions: vec![(SECOND, 6 * SECOND)], ..Faults::delay(RTT / 2) };
    let (mut sim, writer, readers) = Simulation::star(7, faults, 1);
    let topic =
        sim.publish(writer, TopicOptions::reliable(), App { from: 990 * MS, ..App::new(5_000, 10, 1_100 * MS) });
    sim.subscribe(readers[0], topic, RTT, InboundOptions::every());
    sim.run(8 * SECOND);
    assert_eq!(sim.topics[topic].readers[&readers[0]].delivered.len(), 2);
    assert!(sim.topics[topic].heartbeats < 15, "{}", sim.topics[topic].heartbeats);
}

#[test]
fn two_bulk_flows_on_one_bottleneck() {
    for (delay, queue, mark_above) in
        [(10 * MS, 125_000, None), (25 * MS, 600_000, None), (10 * MS, 250_000, Some(60_000)), (2 * MS, 50_000, None)]
    {
        for second_from in [0, 3 * SECOND] {
            let mut sim = Simulation::new(3);
            let [a, b, left, right, c, d] = [(); 6].map(|()| sim.node());
            let perfect = || Faults::delay(0);
            sim.join(a, left, perfect(), perfect());
            sim.join(b, left, perfect(), perfect());
            let bottleneck = Faults { rate: Some(40 * MBIT), queue: Some(queue), mark_above, ..Faults::delay(delay) };
            sim.join(left, right, bottleneck, Faults::delay(delay));
            sim.join(right, c, perfect(), perfect());
            sim.join(right, d, perfect(), perfect());
            let until = 10 * SECOND;
            let history = History { messages: 16, bytes: 64 << 20 };
            let options = TopicOptions { history, ..TopicOptions::reliable() };
            let first = sim.publish(a, options, App::new(100_000, 200, until));
            let second = sim.publish(b, options, App { from: second_from, ..App::new(100_000, 200, until) });
            sim.subscribe(c, first, 2 * delay, InboundOptions::every());
            sim.subscribe(d, second, 2 * delay, InboundOptions::every());
            sim.run(until);
            let got = |topic: usize, reader: usize| {
                let since = 5 * SECOND;
                sim.topics[topic].readers[&reader].delivered.iter().filter(|(_, at)| *at > since).count()
            };
            let (one, two) = (got(first, c), got(second, d));
            assert!(3 * one >= one + two && 3 * two >= one + two, "{one} and {two}");
            assert!((one + two) as u64 * 800_000 / 5 >= 30 * MBIT, "the link is used: {one} + {two}");
        }
    }
}

/// A reliable topic of large messages that is three times as fast as its path. The writer drops
/// whole messages, so that the path carries no useless frames.
#[test]
fn what_is_too_fast_for_its_path_arrives_as_far_as_the_path_goes() {
    let mut sim = Simulation::new(4);
    let [a, b] = [(); 2].map(|()| sim.node());
    let narrow = Faults { rate: Some(40 * MBIT), queue: Some(250_000), ..Faults::delay(2 * MS) };
    sim.join(a, b, narrow, Faults::delay(2 * MS));
    let options = TopicOptions {
        reliability: Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: 10 } },
        history: History { messages: 256, bytes: 3_000_000 },
        ..TopicOptions::reliable()
    };
    let topic = sim.publish(a, options, App::new(500_000, 30, 10 * SECOND));
    sim.subscribe(b, topic, 4 * MS, InboundOptions::every());
    sim.run(10 * SECOND);
    let delivered = sim.topics[topic].readers[&b].delivered.len() as u64;
    assert!(delivered * 500_000 * 8 >= 10 * 40 * MBIT * 7 / 10, "{delivered} messages");
}

/// A gigabit between two hosts.
fn lan() -> Faults {
    Faults { rate: Some(1000 * MBIT), queue: Some(8 << 20), ..Faults::delay(MS / 10) }
}

/// Runs a reliable topic between two hosts whose processors are away at times. Returns the
/// delivered messages, their latencies, and the number of repeated frames.
fn run_on_busy_hosts(app: App, writer: Option<Away>, reader: Option<Away>) -> (usize, Vec<u64>, u64) {
    let mut sim = Simulation::new(11);
    let [a, b] = [(); 2].map(|()| sim.node());
    sim.join(a, b, lan(), lan());
    let options = TopicOptions {
        reliability: Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: 10 } },
        ..TopicOptions::reliable()
    };
    let topic = sim.publish(a, options, app);
    sim.subscribe(b, topic, MS, InboundOptions::every());
    writer.into_iter().for_each(|away| sim.take_away(a, away));
    reader.into_iter().for_each(|away| sim.take_away(b, away));
    sim.run(app.until + SECOND);
    let delivered = sim.topics[topic].readers[&b].delivered.len();
    (delivered, sim.latencies(topic, b), sim.topic_counters(topic).repeated)
}

/// Half of the processors' time belongs to others, in slices of the scheduler.
#[test]
fn hosts_without_a_processor_at_times_lose_nothing_and_are_as_fast() {
    let half = Away { period: 20 * MS, away: 10 * MS, ..Away::default() };
    let other = Away { period: 20 * MS, away: 9 * MS, ..Away::default() };
    for (writer, reader) in [(None, Some(half)), (Some(half), None), (Some(half), Some(other))] {
        let app = App::new(1_000_000, 30, 10 * SECOND);
        let (delivered, latencies, repeated) = run_on_busy_hosts(app, writer, reader);
        assert_eq!((delivered, repeated), (301, 0), "{writer:?} {reader:?}");
        let p99 = percentile(&latencies, 99);
        assert!(p99 < 30 * MS, "{writer:?} {reader:?}: {} ms", p99 / MS);
        // As fast as the path allows.
        let app = App::new(1_000_000, 200, 5 * SECOND);
        let (alone, ..) = run_on_busy_hosts(app, None, None);
        let (busy, _, repeated) = run_on_busy_hosts(app, None, reader);
        assert_eq!(repeated, 0, "{reader:?}");
        assert!(busy * 10 >= alone * 8, "{reader:?}: {busy} of {alone}");
    }
}

/// A writer that processes a request late does not repeat what it has sent meanwhile.
#[test]
fn hosts_that_wait_long_for_a_processor_repeat_nothing() {
    for (writer, reader) in [(40, 25), (30, 60), (15, 35)] {
        let writer = Away { period: 2 * writer * MS, away: writer * MS, ..Away::default() };
        let reader = Away { period: 2 * reader * MS, away: reader * MS, ..Away::default() };
        let app = App::new(1_000_000, 10, 10 * SECOND);
        let (delivered, _, repeated) = run_on_busy_hosts(app, Some(writer), Some(reader));
        assert_eq!((delivered, repeated), (100, 0), "{writer:?} {reader:?}");
    }
}

/// Four busy loops on two processors leave each thread a third of one. Two that take turns see no
/// short round trip, and the pace must make up for the time away.
#[test]
fn hosts_with_a_third_of_a_processor_carry_large_messages() {
    for period in [18, 24, 36] {
        let away = period * MS * 2 / 3;
        let writer = Away { period: period * MS, away, since: 0 };
        for since in [away / 2, away] {
            let reader = Away { since, ..writer };
            let app = App::new(6_000_000, 5, 10 * SECOND);
            let (delivered, latencies, repeated) = run_on_busy_hosts(app, Some(writer), Some(reader));
            assert_eq!((delivered, repeated), (50, 0), "{writer:?} {reader:?}");
            let worst = percentile(&latencies, 100);
            assert!(worst < 300 * MS, "{writer:?} {reader:?}: {} ms", worst / MS);
        }
    }
}

/// Each small message cost a report of its own.
#[test]
fn small_messages_are_reported_ten_times_a_second() {
    for hz in [5, 30, 100] {
        let mut sim = Simulation::new(5);
        let [a, b] = [(); 2].map(|()| sim.node());
        sim.join(a, b, lan(), lan());
        let topic = sim.publish(a, TopicOptions::reliable(), App::new(64, hz, 10 * SECOND));
        sim.subscribe(b, topic, MS, InboundOptions::every_of(1024));
        sim.run(11 * SECOND);
        let reading = &sim.topics[topic].readers[&b];
        assert!(reading.delivered.len() as u64 >= 10 * hz && reading.nacks == 0, "{} Nacks", reading.nacks);
        // One at the start and one at the end besides.
        assert!(reading.reports <= 10 * hz.min(10) + 2, "{} reports at {hz} Hz", reading.reports);
    }
}

/// A publisher with a short history would wait for its readers, or lose what it could repair.
#[test]
fn a_short_history_is_reported_before_it_is_full() {
    let mut sim = Simulation::new(6);
    let [a, b] = [(); 2].map(|()| sim.node());
    sim.join(a, b, lan(), lan());
    let options = TopicOptions { history: History { messages: 10, bytes: 1 << 20 }, ..TopicOptions::reliable() };
    let topic = sim.publish(a, options, App::new(64, 1000, 2 * SECOND));
    sim.subscribe(b, topic, MS, InboundOptions::every_of(10));
    sim.run(3 * SECOND);
    assert_eq!(sim.topics[topic].readers[&b].delivered.len(), 2000);
    let worst = percentile(&sim.latencies(topic, b), 100);
    assert!(worst < 5 * MS, "{} ms", worst / MS);
}

/// A hundred megabits behind a switch with a small buffer. The first bursts overflow it.
#[test]
fn a_short_path_that_is_narrow_is_found_to_be_so() {
    for seed in 0..3 {
        let mut sim = Simulation::new(seed);
        let [a, b] = [(); 2].map(|()| sim.node());
        let narrow = Faults { rate: Some(100 * MBIT), queue: Some(128_000), ..Faults::delay(MS / 10) };
        sim.join(a, b, narrow, Faults::delay(MS / 10));
        let options = TopicOptions {
            reliability: Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: 10 } },
            history: History { messages: 256, bytes: 4_000_000 },
            ..TopicOptions::reliable()
        };
        let topic = sim.publish(a, options, App::new(500_000, 40, 30 * SECOND));
        sim.subscribe(b, topic, MS, InboundOptions::every());
        sim.run(30 * SECOND);
        let delivered = sim.topics[topic].readers[&b].delivered.len() as u64;
        let (sent, repeated) = (sim.topics[topic].sent_bytes, sim.topics[topic].repeated_bytes);
        assert!(delivered * 500_000 * 8 >= 30 * 100 * MBIT * 7 / 10, "{delivered} messages");
        assert!(repeated * 10 < sent, "{repeated} of {sent} bytes are repairs");
    }
}

/// A hundred megabits behind a switch with a large buffer, which loses nothing. The messages of
/// another topic do not stand behind a megabyte.
#[test]
fn a_short_path_with_a_large_buffer_has_no_standing_queue() {
    let mut sim = Simulation::new(3);
    let [a, b] = [(); 2].map(|()| sim.node());
    let narrow = Faults { rate: Some(100 * MBIT), queue: Some(8 << 20), ..Faults::delay(MS / 10) };
    sim.join(a, b, narrow, Faults::delay(MS / 10));
    let options = TopicOptions {
        reliability: Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: 10 } },
        history: History { messages: 256, bytes: 4_000_000 },
        ..TopicOptions::reliable()
    };
    let large = sim.publish(a, options, App::new(500_000, 40, 20 * SECOND));
    sim.subscribe(b, large, MS, InboundOptions::every());
    let small = sim.publish(a, TopicOptions::reliable(), App::new(64, 100, 20 * SECOND));
    sim.subscribe(b, small, MS, InboundOptions::every());
    sim.run(20 * SECOND);
    let median = percentile(&sim.latencies(small, b), 50);
    assert!(median < 60 * MS, "{} ms", median / MS);
}

/// Messages of a few frames with pauses between them. None of them waits because earlier messages
/// have measured little of the path.
#[test]
fn short_messages_with_pauses_never_wait_for_a_report() {
    for size in [8_000, 20_000, 40_000] {
        let mut sim = Simulation::new(6);
        let [a, b] = [(); 2].map(|()| sim.node());
        let fast = Faults { rate: Some(1000 * MBIT), queue: Some(1 << 20), ..Faults::delay(MS / 5) };
        sim.join(a, b, fast, Faults::delay(MS / 5));
        let topic = sim.publish(a, TopicOptions::reliable(), App::new(size, 30, 40 * SECOND));
        sim.subscribe(b, topic, MS, InboundOptions::every());
        sim.run(40 * SECOND);
        let latencies = sim.latencies(topic, b);
        let late = latencies.iter().filter(|latency| **latency > 5 * MS).count();
        assert!(
            latencies.len() > 1190 && late < 5,
            "{size}: {late} of {} are late, {}",
            latencies.len(),
            percentile(&latencies, 99)
        );
    }
}

#[test]
fn a_slow_subscriber_never_slows_the_others() {
    let run = |overflow: Overflow, with_slow: bool| {
        let mut sim = Simulation::new(5);
        let [writer, switch, fast, other, slow] = [(); 5].map(|()| sim.node());
        let link = |mbit: u64| Faults { rate: Some(mbit * MBIT), queue: Some(300_000), ..Faults::delay(5 * MS) };
        sim.join(writer, switch, link(200), Faults::delay(5 * MS));
        for (reader, mbit) in [(fast, 100), (other, 100), (slow, 5)] {
            sim.join(switch, reader, link(mbit), Faults::delay(5 * MS));
        }
        let history = History { messages: 64, bytes: 64 << 20 };
        let options =
            TopicOptions { history, reliability: Reliability::Reliable { overflow }, ..TopicOptions::reliable() };
        let topic = sim.publish(writer, options, App::new(50_000, 100, 10 * SECOND));
        for reader in if with_slow { vec![fast, other, slow] } else { vec![fast, other] } {
            sim.subscribe(reader, topic, 20 * MS, InboundOptions::every());
        }
        sim.run(11 * SECOND);
        if with_slow {
            let reading = &sim.topics[topic].readers[&slow];
            assert!(
                reading.counters().abandoned > 0 && sim.topic_counters(topic).evicted >= reading.counters().abandoned
            );
            assert!(sim.topics[topic].repeated_bytes * 4 < sim.topics[topic].sent_bytes, "nor takes the others' room");
        }
        let latencies = sim.latencies(topic, fast);
        assert_eq!(sim.topics[topic].readers[&fast].counters().abandoned, 0);
        (latencies.len(), percentile(&latencies, 90))
    };
    for overflow in [Overflow::Block, Overflow::DropOldest { keep_last: 10 }] {
        let (alone, alone_p90) = run(overflow, false);
        let (beside, beside_p90) = run(overflow, true);
        assert!(beside * 100 >= alone * 95, "{overflow:?}: {beside} of {alone}");
        // A waiting publisher detects a lagging reader. Without one, the requests of that reader
        // precede new messages.
        let slower = if overflow == Overflow::Block { 2 } else { 20 };
        assert!(beside_p90 <= slower * alone_p90, "{overflow:?}: {beside_p90} instead of {alone_p90}");
    }
}

/// Messages of several frames, twice as fast as a path with a long delay. A gap always exists
/// behind the current message.
#[test]
fn what_a_reader_never_gets_does_not_hold_up_the_rest() {
    let mut sim = Simulation::new(6);
    let [a, b] = [(); 2].map(|()| sim.node());
    let narrow = Faults { rate: Some(16 * MBIT), queue: Some(100_000), ..Faults::delay(25 * MS) };
    sim.join(a, b, narrow, Faults::delay(25 * MS));
    let options = TopicOptions {
        reliability: Reliability::Reliable { overflow: Overflow::DropOldest { keep_last: 10 } },
        history: History { messages: 64, bytes: 64 << 20 },
        ..TopicOptions::reliable()
    };
    let topic = sim.publish(a, options, App::new(8_000, 500, 10 * SECOND));
    sim.subscribe(b, topic, 50 * MS, InboundOptions::every());
    sim.run(10 * SECOND);
    let delivered = &sim.topics[topic].readers[&b].delivered;
    let share = delivered.len() as u64 * 8_000 * 8 * 100 / (10 * 16 * MBIT);
    let longest = delivered.windows(2).map(|pair| pair[1].1 - pair[0].1).max();
    assert!(share >= 60, "{share} % of what the path takes, at most {longest:?} ns apart");
}

#[test]
fn a_reader_that_dies_slows_nobody_for_long() {
    let mut sim = Simulation::new(6);
    let [writer, switch, lives, dies] = [(); 4].map(|()| sim.node());
    sim.join(writer, switch, Faults::delay(5 * MS), Faults::delay(5 * MS));
    sim.join(switch, lives, Faults::default(), Faults::default());
    sim.join(
        switch,
        dies,
        Faults { partitions: vec![(2 * SECOND, 100 * SECOND)], ..Faults::default() },
        Faults::default(),
    );
    let topic = sim.publish(
        writer,
        TopicOptions { history: History { messages: 32, bytes: 64 << 20 }, ..TopicOptions::reliable() },
        App::new(50_000, 100, 10 * SECOND),
    );
    sim.subscribe(lives, topic, 20 * MS, InboundOptions::every());
    sim.subscribe(dies, topic, 20 * MS, InboundOptions::every());
    sim.run(11 * SECOND);
    let reading = &sim.topics[topic].readers[&lives];
    assert!(reading.counters().delivered >= 900, "{:?}", reading.counters());
    assert_eq!(reading.counters().abandoned, 0);
}

#[test]
fn a_reader_that_has_restarted_gets_the_next_large_message_at_once() {
    let (mut sim, writer, readers) = Simulation::star(21, Faults::delay(5 * MS), 1);
    let options = TopicOptions { history: History { messages: 10, bytes: 64 << 20 }, ..TopicOptions::reliable() };
    let topic = sim.publish(writer, options, App::new(900_000, 15, 60 * SECOND));
    sim.subscribe(readers[0], topic, 10 * MS, InboundOptions::every());
    sim.run(5 * SECOND);
    // It ends without a word, and is silent meanwhile.
    sim.topics[topic].readers.remove(&readers[0]);
    sim.run(15 * SECOND);
    sim.subscribe(readers[0], topic, 10 * MS, InboundOptions::every());
    sim.restart_reader(readers[0], topic);
    sim.run(16 * SECOND);
    let (_, first) = *sim.topics[topic].readers[&readers[0]].delivered.first().expect("an image within a second");
    assert!(first < 15 * SECOND + 300 * MS, "{} ms", (first - 15 * SECOND) / MS);
}

/// Readers also greet when a right was renewed, or when somebody makes them doubt.
#[test]
fn a_live_reader_that_joins_again_misses_nothing() {
    let there = Faults { loss: 0.01, rate: Some(10 * MBIT), queue: Some(200_000), ..Faults::delay(10 * MS) };
    let (mut sim, writer, readers) = Simulation::star(22, there, 1);
    let options = TopicOptions { history: History { messages: 10, bytes: 64 << 20 }, ..TopicOptions::reliable() };
    // Twice what the path takes, so that the publisher waits.
    let topic = sim.publish(writer, options, App::new(50_000, 50, 10 * SECOND));
    sim.subscribe(readers[0], topic, 20 * MS, InboundOptions::every());
    while sim.now() < 10 * SECOND {
        sim.run(sim.now() + 150 * MS);
        let (id, now) = (sim.topics[topic].id, sim.now());
        sim.uplink(writer, None).join(now, id, name_of(readers[0])).unwrap();
    }
    sim.run(15 * SECOND);
    let reading = &sim.topics[topic].readers[&readers[0]];
    assert_eq!((reading.delivered.len(), reading.counters().abandoned), (sim.topics[topic].pushed.len() - 1, 0));
}

#[test]
fn churn_of_readers_and_topics_leaves_memory_flat() {
    let faults = Faults::delay(MS);
    let (mut sim, writer, readers) = Simulation::star(8, faults, 4);
    let topic = sim.publish(writer, TopicOptions::reliable(), App::new(64, 10, 1_000 * SECOND));
    for round in 0..100_000_usize {
        let reader = readers[round % readers.len()];
        if round % 500 == 0 {
            sim.subscribe(reader, topic, 2 * MS, InboundOptions::every());
            sim.run(sim.now() + 2 * MS);
            sim.unsubscribe(reader, topic);
        } else {
            let id = sim.topics[topic].id;
            let now = sim.now();
            let uplink = sim.uplink(writer, None);
            uplink.join(now, id, name_of(reader)).unwrap();
            uplink.leave(now, id, &name_of(reader));
        }
    }
    let now = sim.now();
    let uplink = sim.uplink(writer, None);
    let before = format!("{uplink:?}").len();
    for n in 0..10_000_u64 {
        let id = uplink.open(now, name_of(99), [1; 16], TopicOptions::best_effort());
        uplink.join(now, id, name_of(1)).unwrap();
        let first = Position { sequence: 1, index: 0 };
        let message = Sealed::without_bytes(vec![sealed::Frame { first, end: 10 }], 1, 0);
        uplink.push(now, id, message).unwrap();
        if n % 2 == 0 {
            assert!(matches!(uplink.poll(now), Some(Output::Send(_))));
        }
        uplink.close(id);
        assert!(uplink.counters(id).is_none());
    }
    assert!(format!("{uplink:?}").len() < before + 1000, "nothing is left of what came and went");
    assert!(uplink.poll(now).is_none());
}

#[test]
fn two_uplinks_at_once_lose_nothing_when_one_fails() {
    let mut sim = Simulation::new(9);
    let [writer, wifi, lte, reader] = [(); 4].map(|()| sim.node());
    sim.join(
        writer,
        wifi,
        Faults { loss: 0.05, partitions: vec![(3 * SECOND, 100 * SECOND)], ..Faults::delay(2 * MS) },
        Faults::delay(2 * MS),
    );
    sim.join(
        writer,
        lte,
        Faults { rate: Some(20 * MBIT), queue: Some(100_000), loss: 0.02, ..Faults::delay(40 * MS) },
        Faults::delay(40 * MS),
    );
    sim.join(
        wifi,
        reader,
        Faults::default(),
        Faults { partitions: vec![(3 * SECOND, 100 * SECOND)], ..Faults::default() },
    );
    sim.join(lte, reader, Faults::default(), Faults::default());
    sim.second_uplink(writer, 20 * MBIT / 8);
    let options = TopicOptions { doubled: true, ..TopicOptions::reliable() };
    let topic = sim.publish(writer, options, App::new(500, 50, 6 * SECOND));
    sim.subscribe(reader, topic, 10 * MS, InboundOptions::every());
    sim.run(7 * SECOND);
    let reading = &sim.topics[topic].readers[&reader];
    assert_eq!(reading.delivered.len(), 300);
    assert!(reading.counters().duplicates > 100);
    assert!(*sim.latencies(topic, reader).last().unwrap() < 400 * MS);
}

#[test]
fn frames_that_became_too_large_are_sealed_again() {
    let faults = Faults { loss: 0.02, ..Faults::delay(RTT / 2) };
    let (mut sim, writer, readers) = Simulation::star(10, faults, 1);
    let topic = sim.publish(writer, TopicOptions::reliable(), App::new(100_000, 20, 2 * SECOND));
    sim.subscribe(readers[0], topic, RTT, InboundOptions::every());
    for (at, size) in [(500 * MS, 1200), (SECOND, 700), (1_500 * MS, 1300)] {
        sim.run(at);
        sim.set_max_payload(size);
    }
    sim.run(4 * SECOND);
    assert_eq!(sim.topics[topic].readers[&readers[0]].delivered.len(), 40, "{:?}", sim.topic_counters(topic));
}

/// Bursts of loss that are as long as a message, or longer.
#[test]
fn bursts_of_loss_are_repaired() {
    for seed in 0..4 {
        let burst = Some(Burst { enter: 0.002, leave: 0.02, loss: 0.9 });
        let faults = Faults { burst, rate: Some(100 * MBIT), queue: Some(1 << 20), ..Faults::delay(10 * MS) };
        let (mut sim, writer, readers) = Simulation::star(seed, faults, 2);
        let topic = sim.publish(writer, TopicOptions::reliable(), App::new(50_000, 50, 3 * SECOND));
        readers.iter().for_each(|reader| sim.subscribe(*reader, topic, 20 * MS, InboundOptions::every()));
        sim.run(6 * SECOND);
        for reader in &readers {
            assert_eq!(sim.topics[topic].readers[reader].delivered.len(), 150, "{:?}", sim.topic_counters(topic));
        }
    }
}
