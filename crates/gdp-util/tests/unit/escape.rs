//! Unit tests of `escape`.

use super::*;

#[test]
fn what_a_terminal_obeys_is_shown_as_text() {
    for (text, shown) in [
        ("/chatter", "/chatter"),
        ("größer, 大, \u{a0}", "größer, 大, \u{a0}"),
        ("\x1b]0;pwned\x07\x1b[2J", "\\u{1b}]0;pwned\\u{7}\\u{1b}[2J"),
        ("S\n\r\tfake", "S\\n\\r\\tfake"),
        ("\0\x7f\u{9b}31m", "\\u{0}\\u{7f}\\u{9b}31m"),
        ("\u{202e}\u{2066}\u{200f}\u{61c}\u{2028}", "\\u{202e}\\u{2066}\\u{200f}\\u{61c}\\u{2028}"),
        ("", ""),
    ] {
        assert_eq!(Escaped(text).to_string(), shown);
    }
}

#[test]
fn no_control_is_left_of_any_character() {
    for c in char::MIN..=char::MAX {
        let shown = Escaped(c).to_string();
        assert!(!shown.contains(is_control), "{c:?}");
        assert_eq!(shown.chars().count() == 1, !is_control(c), "{c:?}");
    }
    for c in (0..=0x1f).chain(0x7f..=0x9f).chain(0x202a..=0x202e).chain(0x2066..=0x2069) {
        assert!(is_control(char::from_u32(c).unwrap()), "{c:#x}");
    }
}

#[test]
fn json_keeps_its_value() {
    let json = "{\n \"a\u{9b}\": \"\u{202e}\x7f大\"}";
    assert_eq!(escape_json(json), "{\n \"a\\u009b\": \"\\u202e\\u007f大\"}");
    assert!(matches!(escape_json("{\n}"), Cow::Borrowed(_)));
}
