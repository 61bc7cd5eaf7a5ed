//! The daemon's status as JSON, for users and programs.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

use gdp_core::cert::{Adjoining, LinkState};
use gdp_core::peer::Role;
use gdp_link::port::HandshakeCounts;
use gdp_proto::admin::links::{Counts, GraceLink, KeyGenerations, LinkStatus, PeerStatus, PeersReply};
use gdp_proto::admin::status::{
    BusyName, ControlStatus, DeviceStatus, DomainRevocation, DomainStatus, FibStatus, Handshakes, HelloReply,
    InterfaceStatus, Reached, RibStatus, StatusReply,
};
use gdp_proto::admin::tables::{FibReply, FibRoute, RibReply, RibSwitch};
use gdp_proto::admin::topology::{Adjacency, BorderAdjacency, SwitchState, TopologyReply};
use gdp_proto::admin::words::PeerLink;
use gdp_proto::control::RecordKey;
use gdp_wire::{Counter, ErrorCode, FibEntry, Name};

use super::core::Core;
use super::core::link_state::{LinkState as LiveLink, link_role};
use super::core::neighbours::Adjacencies;
use super::daemon::Daemon;
use super::federation::Federation;
use super::{interfaces, warnings};
use crate::domain::{Domain, Relationship};
use gdp_dataplane::{PlaneError, host_pair};
use gdp_util::unix_time::unix_seconds;

/// The number of busiest names in the status.
const BUSIEST: usize = 10;

/// Which switch this is.
pub fn hello(daemon: &Daemon) -> HelloReply {
    HelloReply { name: daemon.core().name(), udp: daemon.udp.get().copied() }
}

/// `gdp-ctl status`.
pub async fn status(daemon: &Arc<Daemon>) -> StatusReply {
    let found = interfaces::list().await.unwrap_or_default();
    let core = daemon.core();
    let report = core.switch.planes.report();
    let (losses, mut errors) = match core.switch.planes.losses() {
        Ok(losses) => (losses, Vec::new()),
        Err(reason) => (Default::default(), vec![reason]),
    };
    let devices = core.switch.planes.dpdk_devices();
    let used = report.iter().map(|plane| {
        let info = found.iter().find(|i| i.name == plane.interface);
        InterfaceStatus {
            interface: plane.interface.clone(),
            data_plane: plane.kind.into(),
            reason: plane.reason.clone(),
            redirect_lost: losses.get(&plane.interface).copied().unwrap_or(0),
            device: devices.get(&plane.interface).map(|counted| DeviceStatus {
                received: counted.received,
                sent: counted.sent,
                missed: counted.missed,
                failed: counted.failed,
            }),
            mtu: info.map(|i| i.mtu),
            addresses: info.map(|i| i.addresses.clone()),
            stations: info.map(|i| i.stations.clone()),
        }
    });
    let interfaces = used.collect();
    let (mut counters, mut counters_by_plane) = (Counts::new(), BTreeMap::new());
    match core.switch.planes.counters() {
        Ok(counted) => {
            for (counter, first, userspace) in counted {
                counters.insert(counter.as_str().into(), first + userspace);
                let planes = [(core.switch.planes.first_plane().into(), first), ("userspace".into(), userspace)];
                counters_by_plane.insert(counter.as_str().into(), planes.into());
            }
        }
        Err(error) => errors.push(error.to_string()),
    }
    let busiest = core.switch.planes.busiest(BUSIEST).unwrap_or_else(|error| {
        errors.push(error.to_string());
        Vec::new()
    });
    errors.extend(core.switch.pending_routes());
    errors.extend(core.rib_host.no_rib.iter().map(|why| format!("the RIB of this replica: {why}")));
    let (data_plane, data_plane_reason) = self::data_plane(&core);
    let dpdk_processor_time = core.switch.planes.dpdk_processor_time();
    StatusReply {
        name: core.name(),
        data_plane: data_plane.into(),
        data_plane_reason,
        interfaces,
        dpdk_processor_time_us: dpdk_processor_time.iter().map(|time| time.as_micros() as u64).collect(),
        udp: daemon.udp.get().copied(),
        links: links(daemon, &core),
        links_in_grace: links_in_grace(&core),
        refused: core.switch.recent_refusals.all(Instant::now()),
        refused_total: core.switch.recent_refusals.total(),
        handshakes: handshakes(daemon.port_config.handshakes.read()),
        counters,
        counters_by_plane,
        busiest: busiest.into_iter().map(|(name, frames)| BusyName { name, frames }).collect(),
        fib: FibStatus {
            names: core.switch.routes.len(),
            generation: core.switch.routes.generation(),
            own_bit: core.switch.routes.own_bit(),
        },
        topology: Reached { switches: core.topology.states().count(), reached: core.topology.paths().costs.len() },
        rib: core
            .rib_host
            .rib
            .as_ref()
            .map(|rib| RibStatus { names: rib.name_count(), switches: rib.switches().count() }),
        domain: core.membership.domain.as_ref().map(domain),
        control: control(&core),
        tiers: core.rib_host.federation.as_ref().map(Federation::status),
        warnings: warnings::warnings(&core),
        errors,
    }
}

/// Returns the handshake counters of peers that dialled and got no link.
fn handshakes(counts: HandshakeCounts) -> Handshakes {
    let HandshakeCounts { challenged, refused, displaced, failed } = counts;
    Handshakes { challenged, refused, displaced, failed }
}

/// Returns the location of the RIB, the next hop to it, and whether it accepts requests, with the
/// reason if not. `fenced` counts the refused messages of RIBs whose term was over.
fn control(core: &Core) -> ControlStatus {
    let rib = core.topology.rib().map(|(rib, _)| rib);
    let problem = core.rib_at().err().filter(|_| core.rib_host.rib.is_none());
    ControlStatus {
        rib,
        next: rib.and_then(|rib| core.topology.paths().next.get(&rib).copied()),
        fenced: core.rib_client.fence.refused(),
        ready: problem.is_none(),
        reason: problem.map(|refusal| refusal.reason),
    }
}

/// Returns the output of `gdp-ctl link list`: every live link, by id.
pub fn links(daemon: &Daemon, core: &Core) -> Vec<LinkStatus> {
    let mut links: Vec<_> = core.switch.links.values().collect();
    links.sort_by_key(|state| state.link.local_id());
    let Adjacencies { neighbours: mut costs, borders, .. } = core.neighbours.adjacencies(&core.switch);
    costs.extend(borders.into_values().map(|border| (border.switch, border.cost)));
    let status = |state: &LiveLink| {
        let (link, peer, id) = (&state.link, state.link.peer(), state.link.local_id());
        let (rx, tx) = link.key_generations();
        let plane =
            if core.switch.planes.first_plane_sends_on(id) { core.switch.planes.first_plane() } else { "userspace" };
        LinkStatus {
            peer: peer.name,
            role: link_role(state.role()),
            lane: peer.lane,
            relationship: (&state.admission.relationship).into(),
            domain: foreign(&state.admission.relationship),
            admitted_until: (state.admission.until < u64::MAX).then_some(state.admission.until),
            via: state.via.to_string(),
            address: daemon.peer_address(link),
            id,
            mtu: link.mtu(),
            key_generations: KeyGenerations { rx, tx },
            cost: costs.get(&peer.name).copied(),
            rtt_us: link.rtt().as_micros() as u64,
            age_s: state.since.elapsed().as_secs(),
            errors_received: errors_received(core, id),
            arrivals: arrivals(core, id),
            traces_refused: state.traces.refused(),
            sent: core.switch.planes.frames_sent(id),
            carrier: core.switch.has_carrier(state.to),
            answers: state.answers,
            plane: plane.into(),
        }
    };
    links.into_iter().map(status).collect()
}

/// Returns the output of `gdp-ctl peer list`, by name: configured neighbours, other switches and
/// domains with links, and recently refused peers. A peer with a link is not refused.
pub fn peers(core: &Core) -> PeersReply {
    let listed = core.neighbours.listed.iter().map(|neighbour| neighbour.address.switch);
    let is_peer =
        |state: &&LiveLink| state.link.peer().role == Role::Switch || foreign(&state.admission.relationship).is_some();
    let linked = core.switch.links.values().filter(is_peer).map(|state| state.link.peer().name);
    let refused = core.switch.refusals.iter().map(|(peer, _)| *peer);
    let all: BTreeSet<Name> = listed.chain(linked).chain(refused).collect();
    PeersReply { domain: core.membership.home(), peers: all.into_iter().map(|peer| self::peer(core, peer)).collect() }
}

fn peer(core: &Core, name: Name) -> PeerStatus {
    let neighbour = core.neighbours.get(&name);
    let link = core.switch.link_to(&name);
    let state = link.as_ref().and_then(|link| core.switch.links.get(&link.local_id()));
    let relationship = state.map(|state| &state.admission.relationship);
    let (ours, theirs) = match relationship {
        Some(Relationship::Border { ours, theirs, .. }) => (Some(ours.to_string()), Some(theirs.to_string())),
        _ => (None, None),
    };
    let refused = core.switch.refusals.iter().find(|(peer, _)| **peer == name).map(|(_, refused)| refused);
    PeerStatus {
        peer: name,
        listed: neighbour.is_some(),
        role: state.map(|state| link_role(state.role())),
        domain: match relationship {
            Some(Relationship::Member { .. }) => core.membership.home(),
            Some(relationship) => foreign(relationship),
            None => None,
        },
        relationship: relationship.map(Into::into),
        rights_granted: ours,
        rights_received: theirs,
        until: state.map(|state| state.admission.until).filter(|until| *until < u64::MAX),
        link: match state {
            Some(_) => PeerLink::Up,
            None if core.switch.stale.keeps(&name) => PeerLink::Grace,
            None => PeerLink::Down,
        },
        via: state.map(|state| state.via.to_string()).or_else(|| neighbour.map(|n| n.address.via.to_string())),
        reason: refused.map(|refused| refused.reason.clone()),
        reason_age_s: refused.map(|refused| refused.at.elapsed().as_secs()),
    }
}

/// Links whose peers fell silent or have a newer one, or that an earlier daemon left; by id.
fn links_in_grace(core: &Core) -> Vec<GraceLink> {
    let mut links: Vec<_> = core.switch.stale.iter().collect();
    links.sort_by_key(|link| link.entry.id);
    let status = links.into_iter().map(|link| GraceLink {
        peer: link.peer,
        role: link_role(link.entry.role),
        address: link.to.to_string(),
        id: link.entry.id,
        answers: link.answers,
        errors_received: errors_received(core, link.entry.id),
    });
    status.collect()
}

/// What became of the frames that came in on a link; counters without any are left out.
fn arrivals(core: &Core, link: u32) -> Option<Counts> {
    let counts = core.switch.planes.arrivals(link);
    let counts = counts.inspect_err(|error| tracing::warn!(link, %error, "a link's counters cannot be read")).ok()?;
    let counts = Counter::ALL.iter().zip(counts).filter(|(_, frames)| *frames > 0);
    Some(counts.map(|(counter, frames)| (counter.as_str().to_owned(), frames)).collect())
}

/// `gdp-ctl topology`: all that this switch knows of the domain's switches, and how it gets there.
pub fn topology(daemon: &Daemon) -> TopologyReply {
    let core = daemon.core();
    let paths = core.topology.paths();
    let switches = core.topology.states().map(|state| SwitchState {
        switch: state.switch,
        bit: paths.bit(&state.switch),
        cost: paths.costs.get(&state.switch).copied(),
        next: paths.next.get(&state.switch).copied(),
        run: state.run,
        number: state.number,
        neighbours: neighbours(state),
        rib: state.rib,
        borders: state.borders.iter().map(border).collect(),
    });
    TopologyReply { own: core.name(), domain: core.membership.home(), switches: switches.collect() }
}

/// Returns the neighbours in a switch's link state.
fn neighbours(state: &LinkState) -> Vec<Adjacency> {
    let is_silent = |index: usize| state.silent & 1 << index != 0;
    let near = state.neighbours.iter().enumerate();
    near.map(|(i, (switch, cost))| Adjacency { switch: *switch, cost: *cost, silent: is_silent(i) }).collect()
}

fn border(&Adjoining { domain, switch, cost, transit, ours_transit, parent }: &Adjoining) -> BorderAdjacency {
    BorderAdjacency { domain, switch, cost, transit, ours_transit, parent }
}

fn domain(domain: &Domain) -> DomainStatus {
    let own = domain.trust.own(unix_seconds());
    let revocations = domain.trust.revocations().filter_map(|kept| kept.verify().ok());
    DomainStatus {
        name: domain.trust.home(),
        role: own.as_ref().ok().map(|cert| cert.role.clone()),
        not_after: own.as_ref().ok().map(|cert| cert.not_after),
        error: own.as_ref().err().map(ToString::to_string),
        members_only: domain.trust.members_only(),
        invitations_used: domain.invitations.all().count(),
        revocations: revocations.map(|r| DomainRevocation { domain: r.name, number: r.number }).collect(),
    }
}

/// Returns the domain of a peer that is of another domain than this switch.
fn foreign(relationship: &Relationship) -> Option<Name> {
    match relationship {
        Relationship::Border { domain, .. } | Relationship::Visitor { domain } | Relationship::Host { domain } => {
            Some(*domain)
        }
        Relationship::Stranger | Relationship::Member { .. } => None,
    }
}

/// Returns how many frames of this switch a neighbour refused, by error code.
fn errors_received(core: &Core, link: u32) -> Counts {
    let errors = ErrorCode::ALL.iter().zip(core.switch.planes.notices().errors(link));
    errors.filter(|(_, count)| *count > 0).map(|(code, count)| (code.as_str().into(), count)).collect()
}

/// Returns one word for the data planes of all interfaces, and the reasons.
pub fn data_plane(core: &Core) -> (&'static str, String) {
    let is_over_udp = |via: &crate::config::Via| matches!(via, crate::config::Via::Udp(_) | crate::config::Via::Tls(_));
    let over_udp = core.switch.links.iter().filter(|(_, state)| is_over_udp(&state.via));
    let udp_links = over_udp.filter(|(id, _)| !core.switch.planes.first_plane_sends_on(**id)).count();
    let report = core.switch.planes.report();
    // Interfaces that the switch created itself are of no interest to the user.
    let outward: Vec<_> = report.into_iter().filter(|plane| !host_pair::is_end(&plane.interface)).collect();
    summary(&outward, udp_links)
}

/// Returns one word for the data planes of all interfaces, and the reasons. `udp_links` counts the
/// links over UDP on which the daemon sends instead of the kernel.
fn summary(report: &[gdp_dataplane::InterfacePlane], udp_links: usize) -> (&'static str, String) {
    let Some(first) = report.first() else {
        return ("userspace", "no Ethernet interface is in use; links over UDP are forwarded by the daemon".into());
    };
    let same = report.iter().all(|plane| plane.kind == first.kind);
    let kind = if same { first.kind } else { "mixed" };
    let mut reasons: Vec<String> = report
        .iter()
        .filter(|plane| !plane.reason.is_empty() || !same)
        .map(|plane| format!("{}: {} {}", plane.interface, plane.kind, plane.reason).trim_end().to_owned())
        .collect();
    if udp_links > 0 {
        reasons.push(format!("the daemon sends on {udp_links} links over UDP"));
    }
    if reasons.is_empty() {
        reasons.push("every interface took it".into());
    }
    (kind, reasons.join("; "))
}

/// Returns one page of `gdp-ctl fib dump`: at most `limit` names after `after`, and whether more
/// follow.
pub fn fib(daemon: &Daemon, after: Option<Name>, limit: usize) -> Result<FibReply, PlaneError> {
    let core = daemon.core();
    let (routes, more) = core.switch.planes.routes_behind(after, limit)?;
    let peers = core.switch.peers_by_link();
    Ok(FibReply { routes: routes.iter().map(|(name, entry)| route(&core, &peers, name, entry)).collect(), more })
}

fn route(core: &Core, peers: &BTreeMap<u32, Name>, name: &Name, entry: &FibEntry) -> FibRoute {
    let own = core.switch.routes.own_bit().map_or(0, |bit| 1u64 << bit);
    let names = |links: Vec<u32>| links.iter().filter_map(|link| peers.get(link)).copied().collect();
    FibRoute {
        name: *name,
        egress_bits: format!("{:#x}", entry.egress_bits),
        own: entry.egress_bits & own != 0,
        toward: core.switch.routes.neighbours_toward(entry.egress_bits & !own),
        readers: names(core.switch.planes.readers(entry)),
        writers: names(core.switch.planes.writers(name)),
        group: entry.group,
    }
}

/// Returns one page of `gdp-ctl rib dump`. Fails with the reason if the RIB is not here.
pub fn rib(daemon: &Daemon, after: Option<RecordKey>, limit: usize) -> Result<RibReply, String> {
    let core = daemon.core();
    let Some(rib) = &core.rib_host.rib else {
        let at = match core.topology.rib() {
            Some((rib, _)) => format!("it is at switch {rib}"),
            None => "and there is no way to it".into(),
        };
        return Err(format!("this daemon is not the RIB, {at}: run `gdp-ctl rib dump` on the RIB's host"));
    };
    let (records, more) = rib.records(core.now(), after, limit);
    let switches = rib.switches().map(|(switch, bit, attached)| {
        let stated = core.topology.states().find(|state| state.switch == switch);
        RibSwitch { switch, bit, neighbours: stated.map_or_else(Vec::new, neighbours), attached }
    });
    Ok(RibReply { records, switches: switches.collect(), more })
}
