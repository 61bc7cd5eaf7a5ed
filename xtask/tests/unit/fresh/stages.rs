//! Unit tests of `fresh::stages`.

use super::*;

#[test]
fn a_sum_needs_all_its_stages() {
    let stages = Stages(vec![("clone", 1.0), ("setup", 2.5)]);
    assert_eq!(stages.sum(&["clone", "setup"]), Some(3.5));
    assert_eq!(stages.sum(&["clone", "run"]), None);
}
