//! Unit tests of `names`.

use super::*;

#[test]
fn what_is_not_a_topic_name_is_refused() {
    let long = format!("/{}", "a".repeat(MAX_TOPIC));
    for text in ["", "/", "chatter", "/a//b", "/a/", "/1a", "/a b", "/a\n", "/é", "rt/chatter", "~/x", &long] {
        assert!(check_topic(text).is_err(), "{text:?}");
    }
    assert_eq!(check_topic("/robot1/image_raw"), Ok(()));
}

#[test]
fn what_is_not_a_type_name_is_refused() {
    for text in ["", "String", "std_msgs/String", "std_msgs/msg/String/x", "std_msgs/foo/String", "std_msgs/msg/"] {
        assert!(check_type(text).is_err(), "{text:?}");
    }
    assert_eq!(check_type("std_srvs/srv/SetBool"), Ok("srv"));
}

#[test]
fn a_refusal_names_the_text_and_the_remedy() {
    let refusal = check_type("std_msgs/String").unwrap_err().to_string();
    assert!(refusal.contains("std_msgs/String") && refusal.contains("package/msg/Name"), "{refusal}");
    assert!(!check_topic("\u{1b}[2J").unwrap_err().to_string().contains('\u{1b}'));
}
