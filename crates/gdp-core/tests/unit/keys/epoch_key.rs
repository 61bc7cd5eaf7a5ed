//! Unit tests of `keys::epoch_key`.

use super::*;

#[test]
fn a_key_is_not_printed() {
    assert_eq!(format!("{:?}", EpochKey::generate().unwrap()), "EpochKey(…)");
}
