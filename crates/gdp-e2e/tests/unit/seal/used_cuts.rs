//! Unit tests of `seal::used_cuts`.

use super::*;

#[test]
fn no_cut_is_used_twice_however_many_there_are() {
    let mut used = UsedCuts::default();
    let mut taken = std::collections::HashSet::new();
    let mut random = gdp_faults::Random::new(1);
    for _ in 0..30_000 {
        let (sequence, cut) = (1 + random.below(6000), random.below(4) as u16);
        if used.take(sequence, cut).is_ok() {
            assert!(cut > 0 && taken.insert((sequence, cut)), "{sequence} {cut}");
        }
        assert!(used.highest.len() <= MAX_MESSAGES);
    }
    assert!(used.floor > 0 && taken.len() > MAX_MESSAGES);
    assert!(used.take(u64::MAX, u16::MAX).is_err());
    assert!(used.take(u64::MAX, u16::MAX - 1).is_ok());
}
