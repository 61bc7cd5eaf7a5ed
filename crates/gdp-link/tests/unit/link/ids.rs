//! Unit tests of `link::ids`.

use super::*;
use std::collections::HashSet;

#[test]
fn ids_are_distinct_not_zero_and_bounded() {
    let ids = LinkIds::new();
    let held: Vec<_> = std::iter::from_fn(|| ids.allocate()).collect();
    assert_eq!(held.len(), MAX_LINKS as usize);
    let indices: HashSet<_> = held.iter().map(|id| gdp_wire::table::link_index(id.get())).collect();
    assert_eq!(indices.len(), MAX_LINKS as usize);
    assert!(held.iter().all(|id| id.get() >= MAX_LINKS));
    assert!(ids.allocate().is_none());
    drop(held);
    assert!(ids.allocate().is_some());
}

#[test]
fn a_reserved_index_is_not_given_out() {
    let ids = LinkIds::new();
    let reserved = ids.reserve(0x1400).expect("nothing is in use");
    assert!(ids.reserve(0x2400).is_none(), "the same index");
    let others: Vec<_> = std::iter::from_fn(|| ids.allocate()).collect();
    assert_eq!(others.len(), MAX_LINKS as usize - 1);
    drop(reserved);
    assert!(ids.reserve(0x2400).is_some());
}
