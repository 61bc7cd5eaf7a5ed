//! Tests of [`super`], with what rmw_zenoh_cpp 0.6.7 writes.

use super::*;

#[test]
fn what_rmw_zenoh_writes_is_read_and_written() {
    let default = Qos::default();
    let timed = Qos {
        deadline_ns: 1_000_000_005,
        lifespan_ns: 2_000_000_000,
        liveliness_ns: 3_000_000_000,
        manual_liveliness: true,
        ..default
    };
    for (text, qos) in [
        ("::,10:,:,:,,", default),
        ("2::,5:,:,:,,", Qos { reliable: false, depth: Some(5), ..default }),
        (":1:,10:,:,:,,", Qos { transient_local: true, ..default }),
        ("::2,10:,:,:,,", Qos { depth: None, ..default }),
        ("::,10:1,5:2,0:3,3,0", timed),
    ] {
        assert_eq!(Qos::parse(text), Some(qos), "{text}");
        assert_eq!(qos.to_string(), text);
    }
}

#[test]
fn explicit_defaults_are_the_same() {
    let infinite = "9223372036,854775807";
    assert_eq!(Qos::parse(&format!("1:2:1,10:{infinite}:{infinite}:1,{infinite}")), Some(Qos::default()));
}

#[test]
fn broken_texts_are_refused() {
    let broken = [
        "",
        ":",
        "::,10:,:,:",
        "::,10:,:,:,,:",
        "3::,10:,:,:,,",
        "::,-1:,:,:,,",
        "::,99999999999:,:,:,,",
        "::10:,:,:,,",
        "::,10:1:,:,,",
        "::,10:18446744073709551616,0:,:,,",
        "::,10:1,18446744073709551615:,:,,",
    ];
    for text in broken {
        assert_eq!(Qos::parse(text), None, "{text}");
    }
}
