//! Unit tests of `workspace`.

use super::*;

#[test]
fn the_manifest_defines_every_profile() {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    for profile in [Profile::Release, Profile::Dist, Profile::Checked] {
        assert!(manifest.contains(&format!("[profile.{}]\n", profile.name())), "{}", profile.name());
    }
}
