//! Unit tests of `keyring::members`.

use super::*;

#[test]
fn a_members_name_has_its_label_first() {
    assert_eq!(parse("/robot7/camera/image"), Some(("robot7", "/camera/image")));
    for wrong in ["/robot7", "/robot7/", "//image", "robot7/image", "/", ""] {
        assert_eq!(parse(wrong), None, "{wrong}");
    }
}

#[test]
fn errors_list_a_bounded_number_of_names() {
    assert_eq!(listed(std::iter::empty()), "nothing");
    assert_eq!(listed(["/a", "/b"].into_iter()), "/a, /b");
    assert!(listed(std::iter::repeat_n("/a", 1000)).ends_with("/a, …"));
}
