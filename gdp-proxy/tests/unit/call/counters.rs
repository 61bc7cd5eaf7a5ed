//! Unit tests of `call::counters`.

use super::*;

#[test]
fn what_waits_is_counted_as_long_as_it_does() {
    let counters = CallCounters::default();
    let pending = counters.begun();
    assert_eq!((counters.read().calls, counters.read().pending), (1, 1));
    drop(pending);
    assert_eq!((counters.read().calls, counters.read().pending), (1, 0));
}
