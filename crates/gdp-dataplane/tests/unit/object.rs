//! Unit tests of `object`.

use super::*;

#[test]
fn a_file_that_was_named_is_the_only_candidate() {
    let missing = Path::new("/nonexistent/gdp-ebpf");
    let found = Object::find(Some(missing)).expect("what was named");
    assert_eq!(found, Object::File(missing.to_owned()));
    assert_eq!(found.bytes().expect_err("there is none").kind(), std::io::ErrorKind::NotFound);
}

#[test]
fn the_embedded_object_is_an_elf_file() {
    // A build without the eBPF toolchain has no embedded object.
    assert!(EMBEDDED.is_none_or(|bytes| bytes.starts_with(b"\x7fELF")));
}
