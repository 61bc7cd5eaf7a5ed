//! Unit tests of `package::deb`: equal executables make equal packages.

use std::path::Path;

use super::super::arch::Arch;
use super::super::build::Build;
use super::super::compile::Executables;
use super::super::{stage, tar};
use super::*;
use crate::workspace;

/// Packs the same executables below a folder, with both compressions, under a umask.
fn packages(folder: &Path, umask: libc::mode_t) -> (u64, Vec<PathBuf>) {
    // SAFETY: umask has no preconditions. Other tests do not depend on modes.
    let before = unsafe { libc::umask(umask) };
    let build = Build { arch: Arch::Amd64, version: "9.8.7".into(), checked: false, quick: false };
    let any = Path::new("/bin/true").to_owned();
    let executables = Executables { ctl: any.clone(), proxy: any, glibc: (2, 31) };
    let mut staged = stage::lay_out(&build, &executables, folder.join("xz")).unwrap();
    let mut files = write(&staged).unwrap();
    files.push(tar::write(&staged).unwrap());
    staged.folder = folder.join("gzip");
    staged.is_checked = true;
    fs::create_dir(&staged.folder).unwrap();
    files.extend(write(&staged).unwrap());
    // SAFETY: as above.
    unsafe { libc::umask(before) };
    (staged.epoch, files)
}

/// Returns the time of a package's first member, which is in the header of `ar`.
fn time(deb: &[u8]) -> u64 {
    std::str::from_utf8(&deb[24..36]).unwrap().trim().parse().unwrap()
}

#[test]
fn packages_of_the_same_executables_are_equal_byte_for_byte() {
    let (here, there) = (tempfile::tempdir().unwrap(), tempfile::tempdir_in(workspace::target()).unwrap());
    let deep = there.path().join("another/folder");
    fs::create_dir_all(&deep).unwrap();
    let (epoch, first) = packages(here.path(), 0o022);
    let (_, second) = packages(&deep, 0o077);
    assert_eq!(first.len(), 7);
    for (one, other) in first.iter().zip(&second) {
        let (one_content, other_content) = (fs::read(one).unwrap(), fs::read(other).unwrap());
        assert!(one_content == other_content, "{} and {} differ", one.display(), other.display());
        if one.extension().is_some_and(|suffix| suffix == "deb") {
            // Not the time at which it was packed.
            assert_eq!(time(&one_content), epoch, "{}", one.display());
        }
    }
}

#[test]
fn a_package_has_the_bill_of_its_executable() {
    let folder = tempfile::tempdir().unwrap();
    let (_, files) = packages(folder.path(), 0o022);
    let listed = |file: &Path| execute(Program::DpkgDeb.command().arg("-c").arg(file)).unwrap();
    for (package, bill) in [("gdp-cli_", "gdp-cli/gdp-ctl.cdx.json"), ("gdp-proxy_", "gdp-proxy/gdp-proxy.cdx.json")] {
        let file = files.iter().find(|file| file.file_name().unwrap().to_string_lossy().starts_with(package));
        let listed = listed(file.unwrap());
        assert!(listed.contains("-rw-r--r-- root/root") && listed.contains(bill), "{listed}");
    }
    let listed = execute(
        Program::Tar.command().arg("-tJf").arg(files.iter().find(|file| file.extension().unwrap() == "xz").unwrap()),
    )
    .unwrap();
    assert!(listed.contains("usr/share/doc/gdp-proxy/gdp-proxy.cdx.json"), "{listed}");
}
