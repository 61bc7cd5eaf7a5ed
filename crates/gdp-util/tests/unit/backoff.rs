//! Unit tests of `backoff`.

use super::*;

const MS: Duration = Duration::from_millis(1);

#[test]
fn delays_double_up_to_the_longest_and_begin_again() {
    let mut backoff = Backoff::new(100 * MS, 350 * MS);
    let delays: Vec<_> = (0..4).map(|_| backoff.next_delay()).collect();
    assert_eq!(delays, [100 * MS, 200 * MS, 350 * MS, 350 * MS]);
    assert_eq!(
        [1, 2, 3, 40, u32::MAX].map(|failures| backoff.after(failures)),
        [100, 200, 350, 350, 350].map(|ms| ms * MS)
    );
    assert_eq!(backoff.delay(), 350 * MS);
    backoff.reset();
    assert_eq!([backoff.delay(), backoff.next_delay(), backoff.delay()], [100 * MS, 100 * MS, 200 * MS]);
}

#[test]
fn jitter_stays_between_half_and_the_whole() {
    assert_eq!(jittered(512 * MS, 0), 256 * MS);
    assert!(jittered(512 * MS, 255) > 500 * MS && jittered(512 * MS, 255) <= 512 * MS);
}
