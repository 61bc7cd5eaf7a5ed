//! Unit tests of `table`.

use super::LinkEntry;

#[test]
fn nothing_prints_a_link_key() {
    let entry = LinkEntry { id: 7, rx_keys: [[0x4242; 2]; 2], tx_keys: [[0x5353; 2]; 2], ..LinkEntry::default() };
    let text = format!("{entry:?} {entry:#x?}");
    for secret in ["4242", "5353", &0x4242.to_string(), &0x5353.to_string()] {
        assert!(!text.contains(secret), "{text}");
    }
}
