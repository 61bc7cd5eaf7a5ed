//! Unit tests of `book::console`.

use super::*;

#[test]
fn a_block_is_split_into_steps() {
    let text = "robot7$ a \\\n  b\nout 1\n\nserver$ c\n";
    let block = Block { language: "console".into(), at: "x".into(), text: text.into() };
    let steps: Vec<_> = steps(&block).into_iter().map(|step| (step.machine, step.command, step.output)).collect();
    assert_eq!(steps[0], ("robot7".into(), "a b".into(), vec!["out 1".into(), String::new()]));
    assert_eq!(steps[1], ("server".into(), "c".into(), vec![]));
    assert_eq!(typed("costs 5$ each"), None);
}

#[test]
fn an_ellipsis_stands_for_any_text_and_white_space_for_a_space() {
    for (shown, printed) in
        [("a …", "a b c"), ("… c", "a b c"), ("a … c", "a  b   c"), ("a", " a "), ("a…c…e", "abcde")]
    {
        assert!(is_as_shown(shown, printed), "{shown}");
    }
    for (shown, printed) in [("a", "a b"), ("a …", "b"), ("… c", "a b"), ("a…b…c", "a c")] {
        assert!(!is_as_shown(shown, printed), "{shown}");
    }
}
