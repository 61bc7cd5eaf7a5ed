//! Unit tests of `package::units`.

use super::*;

#[test]
fn the_score_is_the_last_line_of_the_report() {
    let report = "✗ PrivateNetwork=  Service has access 0.5\n\n→ Overall exposure level for gdp.service: 2.6 OK 🙂\n";
    assert_eq!(exposure(report), Some(2.6));
    assert_eq!(exposure("Failed to load unit"), None);
}

#[test]
fn the_switch_has_the_capabilities_that_it_keeps() {
    let unit = fs::read_to_string(packaging("systemd/gdp-switch.service")).unwrap();
    assert_eq!(setting(&unit, "AmbientCapabilities"), Some(SWITCH));
    assert_eq!(setting(&unit, "Ambient"), None);
}
