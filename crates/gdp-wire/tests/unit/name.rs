//! Unit tests of `name`.

use super::*;

#[test]
fn text_round_trips_and_is_in_wire_order() {
    let mut bytes = [0u8; 32];
    bytes[0] = 0x75;
    bytes[1] = 0xe1;
    bytes[31] = 0xfc;
    let name = Name::from_bytes(bytes);
    let text = name.to_string();
    assert!(text.starts_with("75e1"), "{text}");
    assert_eq!(text.parse(), Ok(name));
    assert_eq!(name.as_bytes(), &bytes);
    assert_eq!(format!("{name:#}"), "75e…0fc");
}

#[test]
fn names_are_ordered_as_their_text_is() {
    let (mut low, mut high) = ([0u8; 32], [0u8; 32]);
    (low[1], low[7], high[0]) = (0xff, 0xff, 1);
    assert!(Name::from_bytes(low) < Name::from_bytes(high));
}

#[test]
fn what_is_not_64_hex_digits_is_refused() {
    for text in ["", "75", &"g".repeat(64), &"0".repeat(63), &"0".repeat(65), &"é".repeat(32)] {
        assert_eq!(text.parse::<Name>(), Err(ParseNameError), "{text:?}");
    }
}
