//! Unit tests of `counter`.

use super::Counter;

#[test]
fn indices_and_names_are_consistent() {
    for (index, counter) in Counter::ALL.iter().enumerate() {
        assert_eq!(*counter as usize, index);
        assert_eq!(counter.is_drop(), counter.as_str().starts_with("drop_"), "{counter:?}");
    }
}
