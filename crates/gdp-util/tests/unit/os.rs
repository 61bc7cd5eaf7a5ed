//! Unit tests of `os`.

use std::fs;

use super::*;

#[test]
fn private_files_are_created_once_and_others_have_no_access() {
    let above = tempfile::tempdir().unwrap();
    let folder = above.path().join("a/b");
    create_private_folder(&folder).unwrap();
    create_private_folder(&folder).unwrap();
    let file = folder.join("file");
    create_private(&file).unwrap();
    assert!(create_private(&file).is_err());
    for (path, wanted) in [(&folder, 0o700), (&file, 0o600)] {
        let mode = mode(&fs::metadata(path).unwrap());
        assert_eq!(mode, cfg!(unix).then_some(wanted), "{}", path.display());
    }
    sync_folder(&folder).unwrap();
    give_to_owner_of(&folder, &open_for_reading(&file).unwrap()).unwrap();
}

#[test]
fn a_replaced_file_is_another() {
    let folder = tempfile::tempdir().unwrap();
    let (one, other) = (folder.path().join("one"), folder.path().join("other"));
    fs::write(&one, "1").unwrap();
    let before = identity(&fs::metadata(&one).unwrap());
    assert_eq!(identity(&fs::metadata(&one).unwrap()), before);
    std::thread::sleep(std::time::Duration::from_millis(20));
    fs::write(&other, "2").unwrap();
    assert_ne!(identity(&fs::metadata(&other).unwrap()), before);
}
