//! Unit tests of `package::compile`.

use super::*;

#[test]
fn the_newest_version_counts_as_numbers_not_as_text() {
    let listed = "\
     1: 0000000000000000     0 FUNC    GLOBAL DEFAULT  UND memcpy@GLIBC_2.14 (2)\n\
     2: 0000000000000000     0 FUNC    GLOBAL DEFAULT  UND read@GLIBC_2.2.5 (3)\n\
     3: 0000000000000000     0 FUNC    WEAK   DEFAULT  UND gettid@GLIBC_2.30 (4)\n\
     4: 0000000000000000     0 FUNC    GLOBAL DEFAULT  UND _Unwind_Resume@GCC_3.0 (5)\n";
    assert_eq!(newest_glibc(listed), Some(((2, 30), "gettid")));
    assert_eq!(newest_glibc("main@GCC_3.0"), None);
}

#[test]
fn an_executable_tells_the_glibc_that_it_needs() {
    let own = std::env::current_exe().unwrap();
    let needs =
        newest_glibc(&shell::output(Program::Readelf.command().args(["--wide", "--dyn-syms"]).arg(&own)).unwrap())
            .map(|(version, _)| version);
    assert_eq!(needed_glibc(&own).ok(), needs);
    assert!(needs.is_some_and(|needs| needs > (2, 0)), "{needs:?}");
    assert!(needed_glibc(Path::new("/etc/hostname")).is_err());
}
