//! The metrics of a switch: the figures of `gdp-ctl status` and `peer list`, for Prometheus. The
//! label values are of closed sets, or of at most [`MAX_SERIES`] links.

use std::collections::HashSet;
use std::sync::Arc;

use gdp_http::metrics::{Exposition, MAX_SERIES, OTHER, PATH};
use gdp_http::{HttpResponse, Listener};
use gdp_proto::admin::links::{Counts, LinkStatus, PeersReply};
use gdp_proto::admin::status::{StatusReply, Warning};
use gdp_proto::admin::words::{PeerLink, PeerRelationship, PeerRole, TierState};

use super::daemon::Daemon;
use super::status;

gdp_http::metrics! {
    BUILD: gauge "gdp_switch_build_info" ["version", "data_plane"] "Always 1; the labels have the release and the data plane";
    FRAMES: counter "gdp_frames" ["counter", "plane"] "Frames by what became of them, drops excepted; see the counters of the data plane";
    DROPS: counter "gdp_frames_dropped" ["reason", "plane"] "Dropped frames by reason; see the counters of the data plane";
    REDIRECT_LOST: counter "gdp_interface_redirect_lost_frames" ["interface"] "Frames that an interface did not take after a redirect of XDP";
    DEVICE: counter "gdp_interface_device_packets" ["interface", "outcome"] "Packets that a device of DPDK counts";
    DPDK_TIME: counter "gdp_dpdk_processor_seconds" ["worker"] "Processor time of a worker of DPDK";
    LINKS: gauge "gdp_links" ["role"] "Live links by the role of the peer";
    LINKS_IN_GRACE: gauge "gdp_links_in_grace" [] "Links whose peers fell silent, or that an earlier daemon left";
    NEIGHBOUR_UP: gauge "gdp_neighbour_up" ["peer"] "Whether a neighbour that the configuration lists has a link";
    LINK_RTT: gauge "gdp_link_rtt_seconds" ["peer", "lane"] "Round-trip time of a link";
    LINK_AGE: gauge "gdp_link_age_seconds" ["peer", "lane"] "Time since a link came up";
    LINK_CARRIER: gauge "gdp_link_carrier" ["peer", "lane"] "Whether the interface of a link has a carrier";
    LINK_ANSWERS: gauge "gdp_link_answers" ["peer", "lane"] "Whether the data plane at the other end of a link answers echoes";
    LINK_SENT: counter "gdp_link_sent_frames" ["peer", "lane"] "Frames sent on a link";
    LINK_RECEIVED: counter "gdp_link_received_frames" ["peer", "lane"] "Frames that came in on a link, dropped ones among them";
    LINK_DROPPED: counter "gdp_link_dropped_frames" ["peer", "lane"] "Frames that came in on a link and were dropped";
    LINK_ERRORS: counter "gdp_link_refused_frames" ["peer", "lane"] "Frames of this switch that the peer of a link refused";
    LINK_ADMITTED: gauge "gdp_link_admission_expiry_timestamp_seconds" ["peer", "lane"] "When the admission of a peer ends";
    HANDSHAKES: counter "gdp_handshakes" ["outcome"] "Handshakes of peers that dialled and got no link";
    REFUSALS: counter "gdp_refusals" ["what", "reason"] "Refused links and registrations";
    FIB_NAMES: gauge "gdp_fib_names" [] "Names that the switch forwards";
    FIB_GENERATION: gauge "gdp_fib_generation" [] "Number of the last push of the RIB";
    SWITCHES: gauge "gdp_topology_switches" ["state"] "Switches of the domain that this one knows, and those that it reaches";
    RIB_READY: gauge "gdp_rib_ready" [] "Whether the RIB can be asked";
    RIB_NAMES: gauge "gdp_rib_names" [] "Names that the RIB here knows";
    RIB_SWITCHES: gauge "gdp_rib_switches" [] "Switches that the RIB here knows";
    FENCED: counter "gdp_rib_fenced_pushes" [] "Pushes refused of RIBs whose terms were over";
    TIER_UP: gauge "gdp_tier_up" ["domain"] "Whether the session with the RIB of a neighbouring domain is up";
    TIER_ENTRIES: gauge "gdp_tier_entries" ["domain", "direction"] "Entries exchanged with a neighbouring domain";
    MEMBERSHIP_VALID: gauge "gdp_switch_membership_valid" [] "Whether the membership of the switch in its domain is valid";
    MEMBERSHIP_EXPIRY: gauge "gdp_switch_membership_expiry_timestamp_seconds" [] "When the membership of the switch ends";
    INVITATIONS: gauge "gdp_invitations_used" [] "Invitations by which machines joined the domain";
    WARNINGS: gauge "gdp_warnings" ["kind"] "What looks wrong though nothing has failed";
    ERRORS: gauge "gdp_errors" [] "Errors that the status shows";
}

/// Serves the metrics until the daemon ends.
pub fn serve(daemon: &Arc<Daemon>, listener: Listener) {
    let served = daemon.clone();
    daemon.spawn(gdp_http::serve(listener, move |request| {
        let daemon = served.clone();
        async move {
            if request.path != PATH {
                return HttpResponse::not_found();
            }
            let status = status::status(&daemon).await;
            let peers = status::peers(&daemon.core());
            exposition(&status, &peers).response(&request)
        }
    }));
}

fn exposition(status: &StatusReply, peers: &PeersReply) -> Exposition {
    let mut all = Exposition::default();
    all.add(&BUILD, [env!("CARGO_PKG_VERSION"), &status.data_plane], 1);
    for (counter, planes) in &status.counters_by_plane {
        for (plane, frames) in planes {
            match counter.strip_prefix(DROP) {
                Some(reason) => all.add(&DROPS, [reason, plane], *frames),
                None => all.add(&FRAMES, [counter, plane], *frames),
            }
        }
    }
    for of in &status.interfaces {
        all.add(&REDIRECT_LOST, [&of.interface], of.redirect_lost);
        let Some(device) = &of.device else { continue };
        let counts = [
            ("received", device.received),
            ("sent", device.sent),
            ("missed", device.missed),
            ("failed", device.failed),
        ];
        counts.iter().for_each(|(outcome, count)| all.add(&DEVICE, [&of.interface, outcome], *count));
    }
    for (worker, micros) in status.dpdk_processor_time_us.iter().enumerate() {
        all.add_real(&DPDK_TIME, [&worker.to_string()], seconds(*micros));
    }
    links(&mut all, status);
    for peer in peers.peers.iter().filter(|peer| peer.listed).take(MAX_SERIES) {
        all.add(&NEIGHBOUR_UP, [&peer.peer.to_string()], (peer.link == PeerLink::Up).into());
    }
    let of = &status.handshakes;
    let counts =
        [("challenged", of.challenged), ("refused", of.refused), ("displaced", of.displaced), ("failed", of.failed)];
    counts.iter().for_each(|(outcome, count)| all.add(&HANDSHAKES, [outcome], *count));
    for (what, kinds) in &status.refused_total {
        kinds.iter().for_each(|(kind, count)| all.add(&REFUSALS, [what, kind], *count));
    }
    all.add(&FIB_NAMES, [], status.fib.names as u64);
    all.add(&FIB_GENERATION, [], status.fib.generation);
    all.add(&SWITCHES, ["known"], status.topology.switches as u64);
    all.add(&SWITCHES, ["reached"], status.topology.reached as u64);
    all.add(&RIB_READY, [], status.control.ready.into());
    all.add(&FENCED, [], status.control.fenced);
    if let Some(rib) = &status.rib {
        all.add(&RIB_NAMES, [], rib.names as u64);
        all.add(&RIB_SWITCHES, [], rib.switches as u64);
    }
    for tier in status.tiers.iter().flatten().take(MAX_SERIES) {
        let domain = tier.domain.to_string();
        all.add(&TIER_UP, [&domain], (tier.state == TierState::Up).into());
        all.add(&TIER_ENTRIES, [&domain, "in"], tier.entries_in as u64);
        all.add(&TIER_ENTRIES, [&domain, "out"], tier.entries_out as u64);
    }
    if let Some(domain) = &status.domain {
        all.add(&MEMBERSHIP_VALID, [], domain.error.is_none().into());
        domain.not_after.iter().for_each(|until| all.add(&MEMBERSHIP_EXPIRY, [], *until));
        all.add(&INVITATIONS, [], domain.invitations_used as u64);
    }
    for kind in Warning::KINDS {
        let count = status.warnings.iter().filter(|warning| warning.kind() == kind).count();
        all.add(&WARNINGS, [kind], count as u64);
    }
    all.add(&ERRORS, [], status.errors.len() as u64);
    all
}

/// Counters of drops begin with it.
const DROP: &str = "drop_";

/// Adds the links of switches and members. All others are summed, because anybody can make them.
fn links(all: &mut Exposition, status: &StatusReply) {
    for role in [PeerRole::Endpoint, PeerRole::Switch, PeerRole::Border] {
        let count = status.links.iter().filter(|link| link.role == role).count();
        all.add(&LINKS, [role.as_str()], count as u64);
    }
    all.add(&LINKS_IN_GRACE, [], status.links_in_grace.len() as u64);
    let is_known =
        |link: &&LinkStatus| link.role != PeerRole::Endpoint || link.relationship == PeerRelationship::Member;
    let (mut known, mut others): (Vec<_>, Vec<_>) = status.links.iter().partition(is_known);
    // The oldest links keep their series.
    known.sort_by_key(|link| link.id);
    others.extend(known.split_off(MAX_SERIES.min(known.len())));
    let mut seen = HashSet::new();
    for link in known {
        if !seen.insert((link.peer, link.lane)) {
            // A newer link of the same lane is taking over.
            others.push(link);
            continue;
        }
        let (peer, lane) = (link.peer.to_string(), link.lane.to_string());
        let labels = [peer.as_str(), lane.as_str()];
        all.add_real(&LINK_RTT, labels, seconds(link.rtt_us));
        all.add(&LINK_AGE, labels, link.age_s);
        all.add(&LINK_CARRIER, labels, link.carrier.into());
        all.add(&LINK_ANSWERS, labels, link.answers.into());
        frames(all, labels, [link]);
        link.admitted_until.iter().for_each(|until| all.add(&LINK_ADMITTED, labels, *until));
    }
    if !others.is_empty() {
        frames(all, [OTHER, OTHER], others);
    }
}

/// Adds the counters of links, summed.
fn frames<'a>(all: &mut Exposition, labels: [&str; 2], links: impl IntoIterator<Item = &'a LinkStatus>) {
    let [mut sent, mut received, mut dropped, mut refused] = [0; 4];
    for link in links {
        let arrivals = link.arrivals.iter().flatten();
        sent += link.sent;
        received += arrivals.clone().map(|(_, frames)| frames).sum::<u64>();
        dropped += arrivals.filter(|(counter, _)| counter.starts_with(DROP)).map(|(_, frames)| frames).sum::<u64>();
        refused += sum(&link.errors_received);
    }
    all.add(&LINK_SENT, labels, sent);
    all.add(&LINK_RECEIVED, labels, received);
    all.add(&LINK_DROPPED, labels, dropped);
    all.add(&LINK_ERRORS, labels, refused);
}

fn sum(counts: &Counts) -> u64 {
    counts.values().sum()
}

fn seconds(micros: u64) -> f64 {
    micros as f64 / 1e6
}

#[cfg(test)]
#[path = "../../tests/unit/serve/metrics.rs"]
mod tests;
