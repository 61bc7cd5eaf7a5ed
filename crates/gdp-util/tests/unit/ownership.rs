//! Unit tests of `ownership`: whose the files are that root creates in another user's folder.
#![allow(clippy::print_stdout, reason = "a skipped test says so")]

use std::os::unix::fs::symlink;

use super::*;

/// Debian's user `nobody`.
const OTHER: u32 = 65534;

#[test]
fn files_are_given_but_no_link_is_followed() {
    if !is_root() {
        println!("skipped: only root gives files away");
        return;
    }
    let above = tempfile::tempdir().unwrap();
    let outside = tempfile::tempdir().unwrap();
    for name in ["target", "twice"] {
        fs::write(outside.path().join(name), "").unwrap();
    }
    let home = above.path().join("home");
    lchown(above.path(), Some(OTHER), Some(OTHER)).unwrap();
    fs::create_dir_all(home.join("server")).unwrap();
    for name in ["switch.pem", "domain.pem", "server/proxy.pem"] {
        fs::write(home.join(name), "").unwrap();
    }
    symlink(outside.path().join("target"), home.join("link")).unwrap();
    symlink(outside.path(), home.join("folder")).unwrap();
    let is_linked = fs::hard_link(outside.path().join("twice"), home.join("hard")).is_ok();

    give_all(&home, &["domain.pem"]).unwrap();
    let owner = |path: PathBuf| path.symlink_metadata().unwrap().uid();
    for name in ["", "switch.pem", "server", "server/proxy.pem"] {
        assert_eq!(owner(home.join(name)), OTHER, "{name}");
    }
    assert_eq!(owner(home.join("domain.pem")), 0);
    assert_eq!(owner(outside.path().to_owned()), 0);
    assert_eq!(owner(outside.path().join("target")), 0);
    assert!(is_linked && owner(outside.path().join("twice")) == 0);

    // The folder itself is a link to one of root's.
    let link = above.path().join("other");
    symlink(outside.path(), &link).unwrap();
    assert!(is_foreign_link(&link));
    give_all(&link, &[]).unwrap();
    assert_eq!(owner(outside.path().join("target")), 0);
}

#[test]
fn new_folders_belong_to_the_owner_above() {
    if !is_root() {
        println!("skipped: only root gives folders away");
        return;
    }
    let above = tempfile::tempdir().unwrap();
    lchown(above.path(), Some(OTHER), Some(OTHER)).unwrap();
    let made = above.path().join("a/b");
    create(&made).unwrap();
    assert_eq!((made.metadata().unwrap().uid(), made.parent().unwrap().metadata().unwrap().uid()), (OTHER, OTHER));
}
