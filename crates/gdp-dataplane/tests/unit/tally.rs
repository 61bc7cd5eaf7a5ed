//! Unit tests of `tally`.

use super::*;

#[test]
fn links_are_told_apart_and_a_new_one_begins_with_nothing() {
    let tally = Tally::default();
    let (a, b) = (0x1401, 0x1402);
    tally.count_arrivals(a, Counter::Forwarded, 3);
    tally.count_arrivals(a, Counter::BadTag, 1);
    tally.count_arrivals(b, Counter::NoLink, 1);
    assert_eq!((tally.of(a)[Counter::Forwarded as usize], tally.of(a)[Counter::BadTag as usize]), (3, 1));
    assert_eq!(tally.of(b), [0; Counter::COUNT], "nobody has this id");
    tally.begin(a ^ 0x2000_0000);
    assert_eq!(tally.of(a), [0; Counter::COUNT]);
}

#[test]
fn a_busy_name_stays_among_many_others() {
    let tally = Tally::default();
    let name = |i: u32| Name::from_bytes(std::array::from_fn(|at| i.to_be_bytes()[at % 4]));
    for i in 0..4 * BUSIEST_NAMES {
        tally.sample(&name(i));
        tally.sample(&name(7));
    }
    let busiest = tally.busiest();
    assert_eq!(busiest.len(), BUSIEST_NAMES as usize);
    assert_eq!(busiest.values().max(), busiest.get(&name(7)), "{:?}", busiest.get(&name(7)));
    assert!(busiest[&name(7)] >= u64::from(4 * BUSIEST_NAMES) * SAMPLING);
}
