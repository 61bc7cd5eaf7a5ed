//! Unit tests of `link::keyed_entry`.

use super::*;
use std::mem::ManuallyDrop;

#[test]
fn its_keys_are_cleared_and_not_printed() {
    let plain = LinkEntry { id: 7, rx_keys: [[0x4242; 2]; 2], tx_keys: [[0x5353; 2]; 2], ..LinkEntry::default() };
    let mut entry = ManuallyDrop::new(KeyedEntry::from(plain));
    let text = format!("{:?} {:#x?}", *entry, *entry);
    assert!(["4242", "5353", "16962", "21331"].iter().all(|secret| !text.contains(secret)), "{text}");
    // SAFETY: dropped once, here. The type owns no memory, so the test may read its fields
    // afterwards.
    unsafe { ManuallyDrop::drop(&mut entry) };
    assert_eq!((entry.rx_keys, entry.tx_keys, entry.id), ([[0; 2]; 2], [[0; 2]; 2], 7));
}
