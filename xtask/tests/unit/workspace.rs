//! Unit tests of `workspace`.

use super::*;

#[test]
fn the_manifest_defines_every_profile() {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    for profile in [Profile::Release, Profile::Dist, Profile::Checked] {
        assert!(manifest.contains(&format!("[profile.{}]\n", profile.name())), "{}", profile.name());
    }
}

/// `dist` inherits from `release`, which optimises some packages less to compile them quickly.
#[test]
fn what_is_shipped_is_optimised_in_full() {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let optimised = |profile: &str| -> Vec<(String, String)> {
        let (_, section) = manifest.split_once(&format!("[profile.{profile}.package]\n")).unwrap();
        let lines = section.lines().take_while(|line| !line.starts_with('['));
        let levels = lines.filter_map(|line| line.split_once(" = { opt-level = "));
        let mut levels: Vec<_> = levels.map(|(package, level)| (package.into(), level.into())).collect();
        levels.sort();
        levels
    };
    let packages = optimised("release").into_iter().map(|(package, _)| (package, "3 }".to_owned()));
    assert_eq!(optimised("dist"), packages.collect::<Vec<_>>());
}
