//! Unit tests of `diagnostics`.

use super::*;
use crate::stats::{Counted, FabricStats};

#[test]
fn a_route_is_as_well_as_its_status_says() {
    let cases = [
        ("up", None, false, Level::Ok),
        ("up", None, true, Level::Warn),
        ("up", Some(Waiting::Reader), false, Level::Warn),
        ("starting", None, false, Level::Stale),
        ("starting", Some(Waiting::Switch), false, Level::Warn),
        ("waiting for a local publisher", Some(Waiting::LocalPublisher), false, Level::Warn),
        ("standing by for 75e1", None, false, Level::Ok),
        ("the right has ended", Some(Waiting::Permission), false, Level::Error),
        ("the right has ended", None, false, Level::Error),
    ];
    for (status, waiting_for, drops, expected) in cases {
        assert_eq!(level(status, waiting_for, drops), expected, "{status}");
    }
}

#[tokio::test]
async fn what_was_counted_is_known_of_the_routes_that_are_there() {
    let entity = Name::from_bytes([7; 32]);
    let ticks = Ticks::new(PERIOD);
    let mut diagnostics = Diagnostics { entity, outlets: vec![], pending: vec![], ticks, before: Before::new() };
    let route = |topic: &str, messages| RouteStats {
        topic: topic.into(),
        graph: "ros2".into(),
        kind: None,
        status: "up".into(),
        waiting_for: None,
        certificate_until: None,
        direction: Side::Out,
        name: entity,
        fabric: FabricStats::None,
        counted: Counted { messages, ..Counted::default() },
    };
    let (graphs, types) = (All::new(), Types::load([]).unwrap());
    diagnostics.tell(&[route("/a", 3), route("/b", 0)], &[], &graphs, &types).await;
    diagnostics.tell(&[route("/a", 5)], &[], &graphs, &types).await;
    let before: Vec<_> = diagnostics.before.into_iter().collect();
    assert_eq!(before, [((entity, "ros2".into(), Side::Out), (5, 0))]);
}

#[test]
fn a_clock_that_differs_is_an_error_that_names_the_peer_and_by_how_much() {
    let (entity, peer) = (Name::from_bytes([7; 32]), Name::from_bytes([8; 32]));
    let status = of_clock(&ClockDifference { peer, ahead_ms: -3_600_000, refuses: false }, entity);
    assert_eq!((status.level, status.name), (Level::Error as u8, format!("gdp_proxy: clock of {peer:#}")));
    assert!(status.message.contains("its clock is 3600 s behind the one here"), "{}", status.message);
    assert!(status.values.iter().any(|value| value.key == "ahead (ms)" && value.value == "-3600000"));
}

/// The definitions are among those that the proxy brings.
#[test]
fn it_is_written_in_either_dialect() {
    let types = Types::load([]).unwrap();
    let ros2 = Kind { dialect: Dialect::Ros2, name: KIND.into(), hash: vec![] };
    let told = Form { kind: &ros2, definition: None, encoding: Encoding::Json };
    let values = vec![Value { key: "rate (Hz)".into(), value: "10".into() }];
    let (name, message, hardware_id) = ("n".to_owned(), "m".to_owned(), "h".to_owned());
    let status = vec![DiagnosticStatus { level: Level::Error as u8, name, message, hardware_id, values }];
    let array = Array { header: DiagnosticHeader { stamp: Stamp { sec: 1, nanosec: 2 }, frame_id: "" }, status };
    let json = bytes::Bytes::from(serde_json::to_vec(&array).unwrap());
    for dialect in [Dialect::Ros1, Dialect::Ros2] {
        let (kind, _) = types.counterpart(&told, dialect).unwrap();
        let native = Form { kind: &kind, definition: None, encoding: dialect.native() };
        let bytes = types.converter(&told, &native).unwrap().convert(json.clone()).unwrap();
        let back = types.converter(&native, &told).unwrap().convert(bytes).unwrap();
        let back: serde_json::Value = serde_json::from_slice(&back).unwrap();
        assert_eq!(back, serde_json::from_slice::<serde_json::Value>(&json).unwrap(), "{dialect:?}");
    }
}
