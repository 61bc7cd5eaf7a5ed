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

#[test]
fn what_is_replicated_is_counted() {
    let counters = CallCounters::default();
    counters.replicated();
    counters.copies_cancelled(2);
    counters.answered_by_other();
    let read = counters.read();
    assert_eq!((read.calls_replicated, read.copies_cancelled, read.answers_by_other), (1, 2, 1));
}
