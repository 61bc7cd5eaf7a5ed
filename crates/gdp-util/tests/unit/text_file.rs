//! Unit tests of `text_file`.

use super::*;

#[test]
fn a_file_is_read_up_to_its_bound() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    assert_eq!(read(&path, 4).unwrap_err().kind(), io::ErrorKind::NotFound);
    std::fs::write(&path, "text").unwrap();
    assert_eq!(read(&path, 4).unwrap().as_deref(), Some("text"));
    assert_eq!(read(&path, 3).unwrap(), None);
    assert_eq!(read(Path::new("/dev/zero"), 3).unwrap(), None);
}

#[test]
fn a_pipe_without_a_writer_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pipe");
    let c_path = std::ffi::CString::new(path.to_str().unwrap()).unwrap();
    // SAFETY: the path is a valid C string.
    assert_eq!(unsafe { libc::mkfifo(c_path.as_ptr(), 0o600) }, 0);
    let error = read(&path, 4).unwrap_err();
    assert!(error.to_string().contains("it is a pipe"), "{error}");
}
