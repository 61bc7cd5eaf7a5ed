//! Unit tests of `remap`.

use gdp_tests::programs::{Executable as _, Program, own};

use super::*;
use crate::shell;

#[test]
fn executables_name_no_folder_of_the_machine_that_compiles() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("main.rs");
    std::fs::write(&source, "fn main() { println!(\"{}\", file!()) }").unwrap();
    let program = folder.path().join("main");
    let elsewhere = Path::new("/elsewhere");
    let flags = of(folder.path(), elsewhere, elsewhere);
    shell::run(Program::Rustc.command().args(flags.split('\u{1f}')).arg("-o").arg(&program).arg(&source)).unwrap();
    assert_eq!(shell::output(&mut own(&program)).as_deref(), Some("/gdp/main.rs"));
}
