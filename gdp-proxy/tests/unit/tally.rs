//! Unit tests of `tally`.

use super::*;

reasons! {
    /// Two of them.
    pub enum Why {
        /// It came too
        /// early.
        Early = "early",
        /// It came too late.
        Late = "late",
    }
}

#[test]
fn reasons_have_their_own_counters() {
    let tally = Tally::default();
    assert!(tally.add(Why::Late, 1) && !tally.add(Why::Late, 2));
    assert_eq!(tally.read(), BTreeMap::from([("early", 0), ("late", 3)]));
    assert_eq!(Why::Early.about().trim(), "It came too early.");
}
