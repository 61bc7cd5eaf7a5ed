//! Replies of the daemon: each survives a round trip through its text form, and matches its schema.

use std::fmt::Debug;

use gdp_proto::admin::event::TimedEvent;
use gdp_proto::admin::links::{LinksReply, PeersReply};
use gdp_proto::admin::status::{HelloReply, StatusReply};
use gdp_proto::admin::tables::FibReply;
use gdp_proto::admin::topology::TopologyReply;
use gdp_proto::admin::trace::{BeyondReply, EchoReply, LocateReply, ProbeReply};
use gdp_proto::admin::{Reply, VERSION, Versioned, error::ErrorReply, reply_line};
use gdp_tests::schema::problems;
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

#[test]
fn each_reply_is_read_as_it_was_written_and_matches_its_schema() {
    let [name, other] = ["7", "a"].map(|digit| digit.repeat(64));
    let errors = json!({"no_route": 2});
    let link = json!({
        "peer": name, "role": "switch", "lane": 0, "relationship": "member", "domain": null, "admitted_until": 9,
        "via": "e0", "address": "192.0.2.1:31415", "id": 7, "mtu": 1452, "key_generations": {"rx": 1, "tx": 2},
        "cost": 3, "rtt_us": 120, "age_s": 5, "errors_received": errors, "arrivals": null, "traces_refused": 0,
        "sent": 4, "carrier": true, "answers": true, "plane": "kernel",
    });
    let interface = json!({
        "interface": "e0", "data_plane": "xdp-native", "reason": "", "redirect_lost": 1, "mtu": 1500,
        "device": {"received": 1, "sent": 2, "missed": 3, "failed": 4}, "addresses": ["192.0.2.1/24"],
        "stations": [["192.0.2.2", "02:00:00:00:00:01"]],
    });
    let status = json!({
        "name": name, "data_plane": "userspace", "data_plane_reason": "asked for", "interfaces": [interface],
        "dpdk_processor_time_us": [7], "udp": "192.0.2.1:31415", "links": [link],
        "links_in_grace": [{"peer": other, "role": "endpoint", "address": "a", "id": 8, "answers": true, "errors_received": {}}],
        "refused_total": {"link": {"NotAdmitted": 2}},
        "refused": [{"peer": name, "what": "link", "reason": "no", "count": 2, "age_s": 3}],
        "handshakes": {"challenged": 1, "refused": 2, "displaced": 3, "failed": 4}, "counters": {"forwarded": 9},
        "counters_by_plane": {"forwarded": {"kernel": 4, "userspace": 5}}, "busiest": [{"name": other, "frames": 64}],
        "fib": {"names": 1, "generation": 2, "own_bit": null}, "topology": {"switches": 2, "reached": 1},
        "rib": {"names": 1, "switches": 1},
        "domain": {"name": name, "role": "switch", "not_after": 7, "error": null, "members_only": true,
            "invitations_used": 1, "revocations": [{"domain": name, "number": 3}]},
        "control": {"rib": name, "next": null, "fenced": 0, "ready": false, "reason": "no path"},
        "tiers": [{"domain": other, "kind": "parent", "state": "up", "reason": null, "entries_in": 1,
            "entries_out": 2, "refused": {"Limit": 3}}],
        "warnings": [{"kind": "silent", "entity": name, "names": 2, "for_s": 11},
            {"kind": "not_served", "count": 1, "names": [name]}],
        "errors": ["of e1"],
    });
    let peer = json!({
        "peer": name, "listed": true, "role": null, "domain": other, "relationship": "border", "rights_granted": "peering",
        "rights_received": "none", "until": 7, "link": "grace", "via": "e0", "reason": "no answer", "reason_age_s": 3,
    });
    let switch = json!({
        "switch": name, "bit": 1, "cost": 2, "next": other, "run": 3, "number": 4, "rib": true,
        "neighbours": [{"switch": other, "cost": 5, "silent": false}],
        "borders": [{"domain": other, "switch": other, "cost": 6, "transit": true, "ours_transit": false, "parent": 0}],
    });
    let route = json!({
        "name": name, "egress_bits": "0x3", "own": true, "toward": [other], "readers": [name], "writers": [],
        "group": 0,
    });
    let end = json!({"links": 1, "beyond": [{"domain": other, "switch": name}]});
    let domain = |outcome: &str, more: Value| {
        let mut hop = json!({"depth": 1, "domain": other, "switch": name, "rtt_us": null, "outcome": outcome});
        hop["reason"] = Value::Null;
        hop.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        hop
    };
    let inside = json!({"links": 1, "rtt_us": 5, "hops": [{"hop": 1, "switch": null, "rtt_us": null}]});

    check::<HelloReply>(json!({"name": name, "udp": null}));
    check::<Box<StatusReply>>(status);
    check::<LinksReply>(json!({"links": [link]}));
    check::<PeersReply>(json!({"domain": null, "peers": [peer]}));
    check::<TopologyReply>(json!({"own": name, "domain": name, "switches": [switch]}));
    check::<FibReply>(json!({"routes": [route], "more": false}));
    check::<LocateReply>(json!({"name": name, "own": other, "near": false, "egress": [name], "end": end}));
    check::<EchoReply>(json!({"rtt_us": 7}));
    check::<ProbeReply>(json!({"switch": null, "rtt_us": null, "end": end}));
    let traced = domain("traced", json!({"inside": inside}));
    check::<BeyondReply>(json!({"domains": [traced, domain("too_far", json!({"reason": "no"}))]}));
    check::<ErrorReply>(json!({"code": "ReplayedSerial", "reason": "rolled back", "remedy": null}));
    for event in [
        json!({"event": "link_up", "peer": name, "role": "border", "relationship": "visitor", "via": "e0", "address": "a"}),
        json!({"event": "link_refused", "peer": name, "via": "e0", "reason": "no"}),
        json!({"event": "missed", "events": 3}),
    ] {
        let mut event = event;
        event["at"] = 7.into();
        check::<TimedEvent>(event);
    }
}

fn check<T>(sample: Value)
where
    T: Serialize + DeserializeOwned + JsonSchema + Into<Reply> + TryFrom<Reply> + Clone + PartialEq + Debug,
{
    let reply: T = serde_json::from_value(sample.clone()).unwrap_or_else(|error| panic!("{sample}: {error}"));
    assert_eq!(serde_json::to_value(&reply).unwrap(), sample);
    let schema = SchemaSettings::draft2020_12().for_serialize().into_generator().into_root_schema_for::<T>();
    assert_eq!(problems(&schema.into(), "", &sample), [""; 0]);
    // Round trip on the line to the command line.
    let read: Versioned<Reply> = serde_json::from_str(&reply_line(&reply.clone().into())).unwrap();
    assert_eq!((read.v, T::try_from(read.value).ok()), (VERSION, Some(reply)));
}
