//! Unit tests of `replay`.

use super::*;
use std::collections::HashSet;
use std::sync::atomic::AtomicU32;

#[test]
fn it_agrees_with_a_set_while_counts_move_on() {
    let window = empty();
    let mut random = random(1);
    let (mut taken, mut highest) = (HashSet::new(), 0);
    for round in 0..200_000u64 {
        let base = if round < 100_000 { 0 } else { (1 << 32) - 100_000 };
        let count = (base + round).saturating_sub(random(TOLERANCE));
        highest = highest.max(count);
        // The inference of high bits is tested below.
        let expected = taken.insert(count);
        assert_eq!(is_fresh(&window, count), expected, "{count} of {highest}");
        assert_eq!(take(&window, count), expected, "{count} of {highest}");
        assert!(!is_fresh(&window, count) && !take(&window, count), "{count} again");
    }
}

#[test]
fn what_is_within_the_tolerance_is_taken_and_what_a_later_block_replaced_is_not() {
    let window = empty();
    let highest = 1_000_000;
    assert!(take(&window, highest));
    assert!(take(&window, highest - (TOLERANCE - 1)));
    assert!(!take(&window, highest - WORDS as u64 * BLOCK), "its word speaks of later counts");
    assert!(take(&window, highest + 1));
}

#[test]
fn the_high_bits_follow_from_the_window() {
    const RING: u64 = WORDS as u64 * BLOCK;
    assert_eq!(whole(&empty(), 0xffff_ffff), 0xffff_ffff, "nothing lies before the first");
    let mut random = random(2);
    for start in [0, (1 << 32) - 5000, 1 << 32, (5 << 32) - 20_000] {
        let window = empty();
        (start.max(RING) - RING..start).for_each(|count| assert!(take(&window, count)));
        for count in start..start + 30_000 {
            let late = count.saturating_sub(random(TOLERANCE));
            assert_eq!(whole(&window, late as u32), late, "after {count}");
            assert_eq!(whole(&window, count as u32), count);
            // One frame in ten is lost.
            assert!(random(10) == 0 || take(&window, count));
        }
    }
}

/// Eight threads try to take every count; each must be taken exactly once.
#[test]
fn threads_that_share_a_window_take_each_count_once() {
    const COUNTS: usize = 100_000;
    let window = empty();
    let taken: Vec<AtomicU32> = (0..COUNTS).map(|_| AtomicU32::new(0)).collect();
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                for (count, taken) in taken.iter().enumerate() {
                    if take(&window, count as u64) {
                        taken.fetch_add(1, Ordering::Relaxed);
                    }
                }
            });
        }
    });
    // A thread may be late by a whole ring, but then another thread has taken the missed counts.
    assert!(taken.iter().all(|taken| taken.load(Ordering::Relaxed) == 1));
}

/// Returns a generator of bounded random numbers, the same in every run.
fn random(mut state: u64) -> impl FnMut(u64) -> u64 {
    move |bound| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) % bound
    }
}
