//! The metrics of a switch say what its status says.

use gdp_http::HttpRequest;
use gdp_proto::admin::links::KeyGenerations;
use gdp_wire::Name;
use serde_json::json;

use super::*;

fn status() -> StatusReply {
    let planes = json!({"forwarded": {"kernel": 5, "userspace": 7}, "drop_no_route": {"kernel": 1, "userspace": 2}});
    let name = Name::from_bytes([1; 32]);
    serde_json::from_value(json!({
        "name": name, "data_plane": "userspace", "data_plane_reason": "", "dpdk_processor_time_us": [1500000],
        "interfaces": [{"interface": "e0", "data_plane": "xdp-native", "reason": "", "redirect_lost": 3,
            "device": {"received": 9, "sent": 8, "missed": 7, "failed": 6}}],
        "udp": null, "links": [], "links_in_grace": [], "refused": [],
        "handshakes": {"challenged": 1, "refused": 2, "displaced": 3, "failed": 4},
        "refused_total": {"link": {"NotAdmitted": 4}}, "counters": {}, "counters_by_plane": planes, "busiest": [],
        "fib": {"names": 11, "generation": 12, "own_bit": null}, "topology": {"switches": 3, "reached": 2},
        "rib": {"names": 13, "switches": 3},
        "domain": {"name": name, "role": "rib", "not_after": 1234, "error": null, "members_only": true,
            "invitations_used": 5, "revocations": []},
        "control": {"rib": name, "next": null, "fenced": 0, "ready": true, "reason": null},
        "tiers": null, "warnings": [], "errors": ["an error"],
    }))
    .unwrap()
}

fn link(peer: u16, id: u32, role: PeerRole, relationship: PeerRelationship) -> LinkStatus {
    let mut name = [0; 32];
    name[..2].copy_from_slice(&peer.to_be_bytes());
    LinkStatus {
        peer: Name::from_bytes(name),
        role,
        lane: 0,
        relationship,
        domain: None,
        admitted_until: Some(99),
        via: "udp".into(),
        address: "127.0.0.1:1".into(),
        id,
        mtu: 1400,
        key_generations: KeyGenerations { rx: 0, tx: 0 },
        cost: None,
        rtt_us: 2500,
        age_s: 60,
        errors_received: [("NotPermitted".into(), 2)].into(),
        arrivals: Some([("forwarded".into(), 10), ("drop_no_route".into(), 1)].into()),
        traces_refused: 0,
        sent: 20,
        carrier: true,
        answers: true,
        plane: "userspace".into(),
    }
}

fn scraped(status: &StatusReply) -> String {
    let peers = serde_json::from_value(json!({"domain": null, "peers": []})).unwrap();
    let request = HttpRequest { path: PATH.into(), query: String::new(), accept: None };
    let body = exposition(status, &peers).response(&request).body;
    String::from_utf8(body.to_vec()).unwrap()
}

#[test]
fn every_figure_is_that_of_the_status() {
    let mut status = status();
    status.links.push(link(7, 1, PeerRole::Switch, PeerRelationship::Member));
    let scraped = scraped(&status);
    let peer = status.links[0].peer;
    for line in [
        "gdp_frames_total{counter=\"forwarded\",plane=\"kernel\"} 5",
        "gdp_frames_dropped_total{reason=\"no_route\",plane=\"userspace\"} 2",
        "gdp_interface_redirect_lost_frames_total{interface=\"e0\"} 3",
        "gdp_interface_device_packets_total{interface=\"e0\",outcome=\"missed\"} 7",
        "gdp_dpdk_processor_seconds_total{worker=\"0\"} 1.5",
        "gdp_handshakes_total{outcome=\"failed\"} 4",
        "gdp_refusals_total{what=\"link\",reason=\"NotAdmitted\"} 4",
        "gdp_fib_names 11",
        "gdp_topology_switches{state=\"reached\"} 2",
        "gdp_rib_ready 1",
        "gdp_switch_membership_expiry_timestamp_seconds 1234",
        "gdp_errors 1",
        &format!("gdp_link_rtt_seconds{{peer=\"{peer}\",lane=\"0\"}} 0.0025"),
        &format!("gdp_link_received_frames_total{{peer=\"{peer}\",lane=\"0\"}} 11"),
        &format!("gdp_link_dropped_frames_total{{peer=\"{peer}\",lane=\"0\"}} 1"),
        &format!("gdp_link_refused_frames_total{{peer=\"{peer}\",lane=\"0\"}} 2"),
    ] {
        assert!(scraped.lines().any(|found| found == line), "{line}: {scraped}");
    }
}

#[test]
fn unknown_peers_and_links_beyond_the_limit_are_summed() {
    let mut status = status();
    let stranger = |id: u16| link(id, id.into(), PeerRole::Endpoint, PeerRelationship::Stranger);
    status.links.extend((0..500).map(stranger));
    let of_strangers = scraped(&status);
    assert!(of_strangers.contains("gdp_link_sent_frames_total{peer=\"other\",lane=\"other\"} 10000"), "{of_strangers}");
    assert!(!of_strangers.contains("gdp_link_rtt_seconds{"), "{of_strangers}");
    let member = |id: u16| link(id, 1000 + u32::from(id), PeerRole::Endpoint, PeerRelationship::Member);
    status.links = (0..500).map(member).collect();
    // A newer link of the same lane.
    status.links.push(link(0, 9000, PeerRole::Endpoint, PeerRelationship::Member));
    status.links.insert(0, link(1, 1, PeerRole::Endpoint, PeerRelationship::Member));
    let scraped = scraped(&status);
    let series = scraped.lines().filter(|line| line.starts_with("gdp_link_sent_frames_total{")).collect::<Vec<_>>();
    assert!(series.len() <= MAX_SERIES + 1, "{} series", series.len());
    let sent: u64 = series.iter().map(|line| line.rsplit(' ').next().unwrap().parse::<u64>().unwrap()).sum();
    assert_eq!(sent, 20 * 502, "nothing is left out or counted twice");
    let names: HashSet<_> = scraped.lines().filter_map(|line| line.rsplit_once(' ')).map(|(name, _)| name).collect();
    assert_eq!(names.len(), scraped.lines().count(), "no series is there twice");
}
