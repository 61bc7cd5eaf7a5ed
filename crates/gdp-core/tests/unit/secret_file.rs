//! Unit tests of `secret_file`.

use super::*;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};

#[test]
fn created_files_are_private_and_complete_and_never_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("secret");
    create(&path, b"one").unwrap();
    assert_eq!(fs::metadata(&path).unwrap().mode() & 0o7777, 0o600);
    assert_eq!(read(&path, 3).unwrap().as_slice(), b"one");

    assert!(matches!(create(&path, b"two"), Err(SecretFileError::Exists(_))));
    assert_eq!(fs::read(&path).unwrap(), b"one");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file stays behind");
    assert!(create(&dir.path().join("no/such/folder"), b"x").is_err());
}

#[test]
fn a_file_is_replaced_as_a_whole() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("secret");
    for content in [b"one".as_slice(), b"three"] {
        replace(&path, content).unwrap();
        assert_eq!(read(&path, 5).unwrap().as_slice(), content);
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o7777, 0o600);
    }
    assert!(replace(&dir.path().join("no/such/folder"), b"x").is_err());
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "no temporary file stays behind");
}

#[test]
fn wider_modes_are_refused_with_the_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("secret");
    create(&path, b"x").unwrap();
    for mode in [0o640, 0o604, 0o660, 0o601, 0o777] {
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        let error = read(&path, 10).unwrap_err().to_string();
        assert!(error.contains(&format!("chmod 600 {}", path.display())), "{error}");
        assert!(error.contains(&format!("{mode:04o}")), "{error}");
    }
    for mode in [0o600, 0o400] {
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        read(&path, 10).unwrap();
    }
}

#[test]
fn a_file_of_another_user_is_refused() {
    let own = os::user().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("secret");
    let another = own + 1;
    assert!(check_owner(&path, own).is_ok() && check_owner(&path, 0).is_ok());
    let error = check_owner(&path, another).unwrap_err();
    assert!(matches!(error, SecretFileError::OfAnother { owner, .. } if owner == another));
    assert!(error.to_string().contains(&format!("chown {own} {}", path.display())), "{error}");
    if own != 0 {
        return;
    }
    create(&path, b"x").unwrap();
    std::os::unix::fs::chown(&path, Some(another), None).unwrap();
    assert!(matches!(read(&path, 1), Err(SecretFileError::OfAnother { .. })));
    std::os::unix::fs::chown(dir.path(), Some(another), None).unwrap();
    assert_eq!(read(&path, 1).unwrap().as_slice(), b"x", "root wrote it for the user of the folder");
}

#[test]
fn only_regular_files_of_sensible_size_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("secret");
    assert!(read(&path, 10).unwrap_err().is_not_found());
    create(&path, b"12345").unwrap();
    assert!(matches!(read(&path, 4), Err(SecretFileError::TooLong { max: 4, .. })));
    assert!(matches!(read(dir.path(), 4), Err(SecretFileError::NotAFile(_))));

    let fifo = dir.path().join("fifo");
    let c_path = std::ffi::CString::new(fifo.to_str().unwrap()).unwrap();
    // SAFETY: `c_path` is a valid NUL-terminated string for the duration of the call.
    assert_eq!(unsafe { libc::mkfifo(c_path.as_ptr(), 0o600) }, 0);
    assert!(matches!(read(&fifo, 4), Err(SecretFileError::NotAFile(_))));
}
