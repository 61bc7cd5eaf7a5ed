//! Problems in replies of a daemon: what is down comes first, and each has its reason.

use serde_json::{Value, json};

use super::*;
use gdp_wire::Name;

const NOW: u64 = 1_000_000;

/// Returns replies of a daemon in which nothing is wrong.
pub fn healthy() -> (Value, Value, Value) {
    let [own, other] = ["7", "a"].map(|digit| digit.repeat(64));
    let status = json!({
        "name": own, "data_plane": "userspace", "data_plane_reason": "", "interfaces": [],
        "dpdk_processor_time_us": [], "udp": "192.0.2.1:31415", "links": [], "links_in_grace": [], "refused": [],
        "refused_total": {}, "handshakes": {"challenged": 0, "refused": 0, "displaced": 0, "failed": 0}, "counters": {"forwarded": 9},
        "counters_by_plane": {}, "busiest": [], "fib": {"names": 1, "generation": 2, "own_bit": 1},
        "topology": {"switches": 2, "reached": 2}, "rib": {"names": 1, "switches": 2},
        "domain": {"name": own, "role": "switch", "not_after": NOW + 30 * 86400, "error": null, "members_only": true,
            "invitations_used": 0, "revocations": []},
        "control": {"rib": own, "next": null, "fenced": 0, "ready": true, "reason": null},
        "tiers": [], "warnings": [], "errors": [],
    });
    let switch = |name: &str, cost: u64, to: &str| {
        json!({
            "switch": name, "bit": 1, "cost": cost, "next": null, "run": 1, "number": 1, "rib": name == own, "borders": [],
            "neighbours": [{"switch": to, "cost": 5, "silent": false}],
        })
    };
    let topology = json!({
        "own": own, "domain": own, "switches": [switch(&own, 0, &other), switch(&other, 5, &own)],
    });
    let peer = json!({
        "peer": other, "listed": true, "role": "switch", "domain": own, "relationship": "member",
        "rights_granted": null, "rights_received": null, "until": null, "link": "up", "via": "e0", "reason": null,
        "reason_age_s": null,
    });
    (status, topology, json!({"domain": own, "peers": [peer]}))
}

fn found(change: impl Fn(&mut Value, &mut Value, &mut Value), labels: &Labels) -> Vec<(Severity, String)> {
    let (mut status, mut topology, mut peers) = healthy();
    change(&mut status, &mut topology, &mut peers);
    let status = serde_json::from_value(status).unwrap();
    let (topology, peers) = (serde_json::from_value(topology).unwrap(), serde_json::from_value(peers).unwrap());
    find(&status, &topology, &peers, labels, NOW).into_iter().map(|p| (p.severity, p.what)).collect()
}

#[test]
fn where_nothing_is_wrong_there_is_no_problem() {
    assert_eq!(found(|_, _, _| {}, &Labels::default()), []);
}

#[test]
fn each_thing_that_is_down_is_named_with_its_reason() {
    type Change = fn(&mut Value, &mut Value, &mut Value);
    let cases: [(Change, Severity, &str); 9] = [
        (
            |status, _, _| {
                status["control"] = json!({"rib": null, "next": null, "fenced": 0, "ready": false, "reason": "no path"})
            },
            Severity::Down,
            "The RIB cannot be reached: no path",
        ),
        (|_, topology, _| topology["switches"][1]["cost"] = Value::Null, Severity::Down, "No path to switch arm"),
        (
            |_, _, peers| {
                peers["peers"][0]["link"] = json!("down");
                peers["peers"][0]["reason"] = json!("no answer\u{1b}[2J");
            },
            Severity::Down,
            "No link to arm (aaa…aaa): no answer\\u{1b}[2J",
        ),
        (|_, _, peers| peers["peers"][0]["link"] = json!("grace"), Severity::Warning, "the peer is silent"),
        (|status, _, _| status["errors"] = json!(["of e1"]), Severity::Down, "of e1"),
        (|status, _, _| status["domain"]["not_after"] = json!(NOW - 1), Severity::Down, "has ended"),
        (|status, _, _| status["domain"]["not_after"] = json!(NOW + 7200), Severity::Warning, "ends in 2 h"),
        (
            |_, topology, _| topology["switches"][0]["neighbours"][0]["silent"] = json!(true),
            Severity::Warning,
            "The daemon of arm (aaa…aaa) does not answer",
        ),
        (
            |status, _, _| {
                let name = "a".repeat(64);
                status["refused"] = json!([{"peer": name, "what": "link", "reason": "no", "count": 2, "age_s": 3}]);
            },
            Severity::Warning,
            "Refused a link of arm (aaa…aaa) (2 times): no",
        ),
    ];
    let mut labels = Labels::default();
    labels.0.insert(Name::from_bytes([0xaa; 32]), "arm".into());
    for (change, severity, what) in cases {
        let problems = found(change, &labels);
        assert_eq!(problems.len(), 1, "{what}: {problems:?}");
        assert!(problems[0].0 == severity && problems[0].1.contains(what), "{what}: {problems:?}");
    }
    let both = |status: &mut Value, topology: &mut Value, _: &mut Value| {
        status["domain"]["not_after"] = json!(NOW + 7200);
        topology["switches"][1]["cost"] = Value::Null;
    };
    let severities: Vec<_> = found(both, &labels).into_iter().map(|(severity, _)| severity).collect();
    assert_eq!(severities.len(), 2);
    assert!(severities.contains(&Severity::Down) && severities.contains(&Severity::Warning));
}
