//! Each fault by itself and all together: seeds are fixed, so what the bounds allow for is the
//! seed's luck alone.

use crate::{Burst, Counts, Delivery, Faults, Link, MILLISECOND, Network, Reorder, SECOND};

const FRAMES: u64 = 100_000;
const BYTES: usize = 1_000;

#[test]
fn a_perfect_link_changes_nothing() {
    let (arrived, counts) = carry(Faults::default(), 1, 0);
    assert!(arrived.iter().map(|delivery| delivery.frame).eq(0..FRAMES));
    assert!(arrived.iter().all(|delivery| delivery.at == 0 && !delivery.marked && delivery.corrupted.is_none()));
    assert_eq!(counts, Counts { sent: FRAMES, delivered: FRAMES, bytes: FRAMES * BYTES as u64, ..Counts::default() });
}

#[test]
fn the_seed_decides_all() {
    let carried = |seed| carry(everything(), seed, 10_000).0;
    assert_eq!(carried(7), carried(7));
    assert_ne!(carried(7), carried(8));
}

#[test]
fn counts_add_up() {
    for seed in 0..10 {
        let (arrived, counts) = carry(everything(), seed, 10_000);
        assert_eq!(arrived.len() as u64, counts.delivered);
        assert_eq!(counts.sent, counts.delivered + counts.missing() - counts.duplicated);
        assert_eq!(arrived.iter().filter(|d| d.corrupted.is_some()).count() as u64, counts.corrupted);
        assert_eq!(arrived.iter().filter(|d| d.marked).count() as u64, counts.marked);
        assert!(arrived.is_sorted_by_key(|delivery| delivery.at));
        let all = [counts.lost, counts.lost_in_bursts, counts.partitioned, counts.overflowed, counts.reordered];
        assert!(all.iter().all(|count| *count > 0), "{counts:?}");
    }
}

#[test]
fn frames_are_lost_as_often_as_said() {
    let counts = carry(Faults { loss: 0.1, ..Faults::default() }, 2, 0).1;
    assert_near(counts.lost, 0.1);
    assert_eq!(counts.missing(), counts.lost);
}

#[test]
fn bursts_are_as_long_and_as_frequent_as_said() {
    let burst = Burst { enter: 0.01, leave: 0.2, loss: 1.0 };
    let (arrived, counts) = carry(Faults { burst: Some(burst), ..Faults::default() }, 3, 0);
    let gaps = arrived.windows(2).map(|pair| pair[1].frame - pair[0].frame - 1).filter(|gap| *gap > 0);
    let (bursts, longest) = (gaps.clone().count() as f64, gaps.max().unwrap_or(0));
    let mean = counts.lost_in_bursts as f64 / bursts;
    assert!((4.5..5.5).contains(&mean) && longest > 15, "mean {mean}, longest {longest}");
    // Of the time in the bad state, which is enter / (enter + leave); it comes in runs, so the
    // bound is wider than a coin's.
    let share = counts.lost_in_bursts as f64 / FRAMES as f64;
    assert!((0.043..0.053).contains(&share), "{share}");
}

#[test]
fn duplicates_come_as_often_as_said_and_lose_nothing() {
    let (arrived, counts) = carry(Faults { duplicate: 0.05, ..Faults::default() }, 4, 0);
    assert_near(counts.duplicated, 0.05);
    let mut once: Vec<u64> = arrived.into_iter().map(|delivery| delivery.frame).collect();
    once.dedup();
    assert!(once.into_iter().eq(0..FRAMES));
}

#[test]
fn jitter_keeps_the_order_and_reordering_does_not() {
    let faults = Faults { delay: MILLISECOND, jitter: 5 * MILLISECOND, ..Faults::default() };
    let arrived = carry(faults.clone(), 5, 10_000).0;
    assert!(arrived.iter().map(|delivery| delivery.frame).eq(0..FRAMES));
    let took = |d: &Delivery<u64>| d.at - d.frame * 10_000;
    assert!(arrived.iter().all(|d| (MILLISECOND..=6 * MILLISECOND).contains(&took(d))));
    let reorder = Some(Reorder { probability: 0.02, by: MILLISECOND });
    let (arrived, counts) = carry(Faults { jitter: 0, reorder, ..faults }, 5, 10_000);
    assert_near(counts.reordered, 0.02);
    let overtaken = arrived.windows(2).filter(|pair| pair[1].frame < pair[0].frame).count() as f64;
    assert!(overtaken > 0.01 * FRAMES as f64, "{overtaken}");
}

#[test]
fn corruption_turns_one_bit_and_spares_what_it_must() {
    let mut link = Link::new(Faults { corrupt: 0.5, ..Faults::default() }, 6);
    let sound = vec![0x5a; 40];
    for _ in 0..FRAMES {
        link.push(0, sound.clone(), sound.len());
    }
    let counts = link.counts();
    assert_near(counts.corrupted, 0.5);
    let mut corrupted = 0;
    while let Some(mut delivery) = link.pop(0) {
        delivery.damage(14);
        let bits: u32 = delivery.frame.iter().zip(&sound).map(|(a, b)| (a ^ b).count_ones()).sum();
        assert_eq!(bits, u32::from(delivery.corrupted.is_some()));
        assert_eq!(delivery.frame[..14], sound[..14]);
        corrupted += u64::from(bits);
    }
    assert_eq!(corrupted, counts.corrupted);
}

#[test]
fn the_rate_spaces_frames_and_a_full_queue_drops_the_last() {
    // 8 Mb/s: a millisecond a frame, of which a tenth has room.
    let queue = Some(10 * BYTES as u64);
    let faults = Faults { rate: Some(8_000_000), queue, mark_above: Some(5 * BYTES as u64), ..Faults::default() };
    let mut link = Link::new(faults, 0);
    for frame in 0..20 {
        link.push(0, frame, BYTES);
    }
    let arrived = drain(&mut link);
    let expected = (0..10).map(|i| (i, (i + 1) * MILLISECOND, i > 5));
    assert!(arrived.into_iter().map(|d| (d.frame, d.at, d.marked)).eq(expected));
    assert_eq!((link.counts().overflowed, link.counts().marked), (10, 4));
    // Empty again.
    link.push(SECOND, 20, BYTES);
    assert_eq!(link.next(), Some(SECOND + MILLISECOND));
}

#[test]
fn nothing_gets_through_a_partition() {
    let faults = Faults { partitions: vec![(SECOND, 4 * SECOND)], ..Faults::delay(MILLISECOND) };
    let arrived = carry(faults, 0, 100_000).0;
    let missing = |d: &Delivery<u64>| (10_000..40_000).contains(&d.frame);
    assert!(arrived.len() as u64 == FRAMES - 30_000 && !arrived.iter().any(missing));
}

#[test]
fn one_fault_does_not_change_another() {
    let lost = |faults: Faults| {
        let mut arrived: Vec<u64> = carry(faults, 9, 10_000).0.into_iter().map(|delivery| delivery.frame).collect();
        arrived.sort_unstable();
        arrived.dedup();
        arrived
    };
    let loss = Faults { loss: 0.1, ..Faults::default() };
    let reorder = Some(Reorder { probability: 0.5, by: SECOND });
    let more = Faults { duplicate: 0.3, corrupt: 0.3, jitter: MILLISECOND, reorder, ..loss.clone() };
    assert_eq!(lost(loss), lost(more));
}

#[test]
fn answers_come_back_after_a_round_trip() {
    let mut network = Network::new(1);
    let cable = network.join([0, 1], Faults::delay(20 * MILLISECOND), Faults::delay(30 * MILLISECOND));
    network.send(0, cable, "question", BYTES);
    let arrival = network.arrival(SECOND).unwrap();
    assert_eq!((arrival.from, arrival.to, arrival.delivery.frame, network.now()), (0, 1, "question", 20 * MILLISECOND));
    network.send(1, arrival.cable, "answer", BYTES);
    assert_eq!(network.arrival(40 * MILLISECOND), None);
    assert_eq!(network.now(), 40 * MILLISECOND);
    let arrival = network.arrival(SECOND).unwrap();
    assert_eq!((arrival.to, arrival.delivery.frame, network.now()), (0, "answer", 50 * MILLISECOND));
    assert_eq!(network.arrival(SECOND), None);
    assert_eq!((network.counts(0, cable).delivered, network.counts(1, cable).delivered), (1, 1));
}

#[test]
fn two_flows_share_a_bottleneck_and_two_cables_do_not() {
    const LEFT: usize = 0;
    const RIGHT: usize = 1;
    const ROUTER: usize = 2;
    const SINK: usize = 3;
    // A thousand frames a second through the bottleneck, and each flow offers as many.
    let bottleneck = Faults { rate: Some(8_000_000), queue: Some(10 * BYTES as u64), ..Faults::default() };
    let mut network = Network::new(2);
    let flows = [LEFT, RIGHT].map(|flow| (flow, network.join([flow, ROUTER], Faults::default(), Faults::default())));
    let shared = network.join([ROUTER, SINK], bottleneck.clone(), Faults::default());
    let own = network.join([LEFT, SINK], bottleneck, Faults::default());
    let mut arrived = [0; 2];
    for i in 0..1_000 {
        for (flow, cable) in flows {
            network.send(flow, cable, flow, BYTES);
        }
        network.send(LEFT, own, LEFT, BYTES);
        while let Some(arrival) = network.arrival((i + 1) * MILLISECOND) {
            match arrival.to {
                ROUTER => network.send(ROUTER, shared, arrival.delivery.frame, BYTES),
                _ => arrived[usize::from(arrival.cable == own)] += 1,
            }
        }
    }
    assert!((990..=1_000).contains(&arrived[0]) && arrived[1] == 1_000, "{arrived:?}");
    assert!(network.counts(ROUTER, shared).overflowed > 950);
}

fn everything() -> Faults {
    Faults {
        rate: Some(1_000_000_000),
        queue: Some(60_000),
        mark_above: Some(20_000),
        delay: MILLISECOND,
        jitter: MILLISECOND,
        loss: 0.01,
        burst: Some(Burst { enter: 0.001, leave: 0.1, loss: 0.9 }),
        reorder: Some(Reorder { probability: 0.01, by: MILLISECOND }),
        duplicate: 0.01,
        corrupt: 0.01,
        partitions: vec![(SECOND / 2, SECOND / 2 + 10 * MILLISECOND)],
    }
}

/// Frames 0, 1, 2 … through a link, `every` nanoseconds one.
fn carry(faults: Faults, seed: u64, every: u64) -> (Vec<Delivery<u64>>, Counts) {
    let mut link = Link::new(faults, seed);
    for frame in 0..FRAMES {
        // Now and then more at once than the queue holds.
        let bytes = if frame % 5_000 < 100 { 2 * BYTES } else { BYTES };
        link.push(frame * every, frame, if every == 0 { BYTES } else { bytes });
    }
    (drain(&mut link), link.counts())
}

fn drain<T: Clone>(link: &mut Link<T>) -> Vec<Delivery<T>> {
    std::iter::from_fn(|| link.pop(link.next()?)).collect()
}

/// Within four standard deviations of a coin with this probability.
fn assert_near(count: u64, probability: f64) {
    let (mean, n) = (probability * FRAMES as f64, FRAMES as f64);
    let deviation = (n * probability * (1.0 - probability)).sqrt();
    assert!((count as f64 - mean).abs() < 4.0 * deviation, "{count} of {FRAMES}, expected {mean} ± {deviation}");
}
