use serde_json::json;

use super::*;

#[test]
fn rounds_are_merged_and_losses_are_counted() {
    let text = report("igc", [&[1.0, 3.0], &[2.0]], [&[4.0, 6.0], &[]]).to_string();
    assert!(text.contains("\n| 64 B | 2.00, 3.00 | 4.00, 6.00 | 2.00 | 1 of 4, 2 of 4 |\n"), "{text}");
}

#[test]
fn only_figures_of_virtual_interfaces_are_marked() {
    let of = |driver| report(driver, [&[1.0], &[1.0]], [&[1.0], &[1.0]]).to_string();
    assert_eq!(of("veth").matches(&mark("veth")).count(), 1);
    assert!(!of("igc").contains("not figures of a NIC"));
}

#[test]
fn a_row_without_a_reply_is_not_whole() {
    assert!(report("igc", [&[1.0], &[1.0]], [&[1.0], &[1.0]]).is_whole());
    assert!(!report("igc", [&[1.0], &[1.0]], [&[1.0], &[]]).is_whole());
}

/// Two rounds over each path, with two requests each; times are in milliseconds.
fn report(driver: &str, dds: [&[f64]; 2], gdp: [&[f64]; 2]) -> FieldReport {
    let row = |path, (round, times): (usize, &&[f64])| RoundTrips {
        bytes: 64,
        path,
        round,
        lost: 2 - times.len(),
        damaged: 0,
        times: times.iter().map(|ms| Duration::from_secs_f64(ms / 1e3)).collect(),
    };
    let of_dds = dds.iter().enumerate().map(|it| row("dds", it));
    let facts = json!({
        "kernel": "6.1", "processor": "a processor", "cores": 2, "interface": "eth0", "driver": driver,
        "speed": "1000Mb/s", "mtu": 1500,
    });
    let machine: MachineFacts = serde_json::from_value(facts).expect("facts");
    FieldReport {
        rows: of_dds.chain(gdp.iter().enumerate().map(|it| row("gdp", it))).collect(),
        robot: machine.clone(),
        edge: machine,
        data_plane: "xdp-native".to_owned(),
    }
}
