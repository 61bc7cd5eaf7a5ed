//! Unit tests of `package::changelog`.

use super::*;

const SOURCE: &str = "# Changelog\n\n## [0.2.0] - 2026-11-26\n\n### Added\n\n- One thing,\n  with more.\n- Another.\n\n\
                      ## [0.1.0] - 2026-02-28\n\n- First.\n";

#[test]
fn each_release_is_an_entry_with_its_day_of_the_week() {
    let made = debian(SOURCE, "0.2.0").unwrap();
    let first = "gdp (0.2.0-1) unstable; urgency=medium\n\n  * One thing, with more.\n  * Another.\n\n -- ";
    assert!(made.starts_with(first), "{made}");
    assert!(made.contains("  Thu, 26 Nov 2026 00:00:01 +0000\n"), "{made}");
    assert!(made.contains("  Sat, 28 Feb 2026 00:00:00 +0000\n"), "{made}");
}

#[test]
fn a_long_change_is_wrapped_between_words() {
    let made = wrapped(&"word ".repeat(40));
    assert!(made.lines().count() == 3 && made.lines().all(|line| line.len() <= COLUMNS), "{made}");
    assert!(made.starts_with("  * word") && made.contains("\n    word"), "{made}");
}

#[test]
fn a_version_between_releases_has_an_entry() {
    let made = debian(SOURCE, "0.2.1").unwrap();
    assert!(made.starts_with("gdp (0.2.1-1) unstable"), "{made}");
    assert_eq!(made.matches("urgency=medium").count(), 3);
}

#[test]
fn the_changelog_of_this_source_has_its_version() {
    let text = fs::read_to_string(workspace::root().join("CHANGELOG.md")).unwrap();
    assert_eq!(entries(&text).unwrap()[0].0, env!("CARGO_PKG_VERSION"));
    assert!(debian("no versions", "0.1.0").is_err());
    assert!(rfc_2822("2026-13-01").is_err());
}
