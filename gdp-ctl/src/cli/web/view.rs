//! Replies of the daemon as lines of the page.

use std::collections::{BTreeMap, BTreeSet};

use gdp_proto::admin::links::{LinkStatus, PeerStatus, PeersReply};
use gdp_proto::admin::status::StatusReply;
use gdp_proto::admin::tables::{FibReply, FibRoute, RibReply};
use gdp_proto::admin::topology::TopologyReply;
use gdp_proto::admin::words::{PeerLink, PeerRole};
use gdp_wire::Name;

use super::snapshot::{
    Bounded, DomainLine, Labelled, Labels, LinkLine, MapEdge, MapNode, NameLine, OwnSwitch, PageSnapshot, RobotLine,
    text,
};
use crate::cli::home::RobotsOutput;
use crate::cli::topology::{Edge, edges};

/// Most switches on the map: more are not legible.
pub const MAX_NODES: usize = 60;

/// Most rows of a table.
pub const MAX_ROWS: usize = 100;

/// Most entities that a row names.
const MAX_ENTITIES: usize = 3;

/// The names that the switch or its RIB knows, and how many there are.
#[derive(Debug, Default)]
pub struct NamesInUse {
    /// Writers and readers.
    pub roles: BTreeMap<Name, Roles>,
    /// Entities at each switch; none if the RIB is elsewhere.
    pub attached: Option<BTreeMap<Name, usize>>,
    /// These are all names of the RIB, so that any other one is the name of an endpoint.
    pub is_complete: bool,
}

/// The entities of a name.
#[derive(Clone, Debug, Default)]
pub struct Roles {
    pub writers: Vec<Name>,
    pub readers: Vec<Name>,
    pub is_service: bool,
}

impl Roles {
    /// Whether nobody publishes or reads it, as far as is known. With all names of the RIB known,
    /// it is the name of an entity itself, to which others send reports and requests.
    fn is_unused(&self) -> bool {
        self.writers.is_empty() && self.readers.is_empty()
    }
}

impl NamesInUse {
    pub fn of_rib(reply: &RibReply) -> Self {
        let mut roles = BTreeMap::<Name, Roles>::new();
        for record in &reply.records {
            let (Ok(role), Ok(entity)) = (record.role(), record.entity.name()) else { continue };
            let known = roles.entry(record.name).or_default();
            let side = if role.is_writer() { &mut known.writers } else { &mut known.readers };
            side.push(entity);
            known.is_service = role.is_of_service();
        }
        let attached = reply.switches.iter().map(|switch| (switch.switch, switch.attached.len())).collect();
        Self { roles, attached: Some(attached), is_complete: !reply.more }
    }

    pub fn of_fib(reply: &FibReply) -> Self {
        let of = |route: &FibRoute| {
            let roles = Roles { writers: route.writers.clone(), readers: route.readers.clone(), is_service: false };
            (route.name, roles)
        };
        Self { roles: reply.routes.iter().map(of).collect(), attached: None, is_complete: false }
    }
}

/// Fills the parts of a snapshot that come from the daemon.
pub fn fill(
    snapshot: &mut PageSnapshot,
    status: &StatusReply,
    topology: &TopologyReply,
    peers: &PeersReply,
    names: &NamesInUse,
    labels: &Labels,
) {
    snapshot.switch = Some(own(status, labels));
    (snapshot.nodes, snapshot.edges) = map(topology, names, labels);
    snapshot.links = links(status, peers, labels);
    snapshot.names = name_lines(status, names, labels);
    snapshot.domains = domains(status, topology, peers, labels);
    snapshot.counters = status.counters.clone();
}

fn own(status: &StatusReply, labels: &Labels) -> OwnSwitch {
    OwnSwitch {
        switch: labels.of(status.name),
        domain: status.domain.as_ref().map(|domain| labels.of(domain.name)),
        data_plane: status.data_plane.clone(),
        udp: status.udp.map(|udp| udp.to_string()),
        rib: status.control.rib.map(|rib| labels.of(rib)),
        rib_here: status.rib.is_some(),
        ready: status.control.ready,
        fib_names: status.fib.names,
        rib_names: status.rib.as_ref().map(|rib| rib.names),
        switches: status.topology.switches,
        reached: status.topology.reached,
        member_until: status.domain.as_ref().and_then(|domain| domain.not_after),
    }
}

/// Returns the map. Its own switch and those without a path come first, so that a bound does not
/// hide them.
fn map(topology: &TopologyReply, names: &NamesInUse, labels: &Labels) -> (Bounded<MapNode>, Vec<MapEdge>) {
    let edges = edges(topology);
    let mut nodes: Vec<MapNode> = Vec::new();
    for switch in &topology.switches {
        nodes.push(MapNode {
            switch: labels.of(switch.switch),
            own: switch.switch == topology.own,
            rib: switch.rib,
            reached: switch.switch == topology.own || switch.cost.is_some(),
            domain: None,
            attached: names.attached.as_ref().map(|attached| attached.get(&switch.switch).copied().unwrap_or(0)),
        });
    }
    nodes.sort_by_key(|node| (!node.own, node.reached));
    let mut known: BTreeSet<Name> = topology.switches.iter().map(|switch| switch.switch).collect();
    for Edge { ends: [_, other], domain, .. } in &edges {
        if known.insert(*other) {
            let domain = domain.map(|domain| labels.of(domain));
            // A switch of this domain that has not stated anything is not reached.
            let reached = domain.is_some();
            let (switch, attached) = (labels.of(*other), None);
            nodes.push(MapNode { switch, own: false, rib: false, reached, domain, attached });
        }
    }
    let nodes = Bounded::new(nodes, MAX_NODES);
    let shown: BTreeSet<&str> = nodes.rows.iter().map(|node| node.switch.name.as_str()).collect();
    let silent: BTreeSet<Name> =
        topology.switches.iter().flat_map(|s| &s.neighbours).filter(|n| n.silent).map(|n| n.switch).collect();
    let line = |edge: &Edge| {
        let state = match edge.by_both {
            false => "half",
            true if edge.ends.iter().any(|end| silent.contains(end)) => "silent",
            true => "up",
        };
        MapEdge { ends: edge.ends.map(|end| end.to_string()), cost: edge.cost, state }
    };
    let edges = edges.iter().map(line).filter(|edge| edge.ends.iter().all(|end| shown.contains(end.as_str())));
    let edges = edges.collect();
    (nodes, edges)
}

/// Returns the peers without a link, then the links.
fn links(status: &StatusReply, peers: &PeersReply, labels: &Labels) -> Bounded<LinkLine> {
    let missing = peers.peers.iter().filter(|peer| peer.link != PeerLink::Up).map(|peer| without_link(peer, labels));
    let mut live: Vec<&LinkStatus> = status.links.iter().collect();
    // Switches before endpoints.
    live.sort_by_key(|link| (link.role == PeerRole::Endpoint, link.id));
    Bounded::new(missing.chain(live.into_iter().map(|link| live_link(link, labels))), MAX_ROWS)
}

fn without_link(peer: &PeerStatus, labels: &Labels) -> LinkLine {
    LinkLine {
        peer: labels.of(peer.peer),
        role: peer.role.map_or("–", PeerRole::as_str),
        state: peer.link.as_str(),
        via: text(peer.via.as_deref().unwrap_or("–")),
        address: String::new(),
        plane: String::new(),
        rtt_us: None,
        age_s: peer.reason_age_s,
        sent: 0,
        arrived: 0,
        dropped: 0,
        refused: 0,
        reason: Some(text(peer.reason.as_deref().unwrap_or("silent"))),
    }
}

fn live_link(link: &LinkStatus, labels: &Labels) -> LinkLine {
    let arrivals = link.arrivals.iter().flatten();
    let sum = |dropped: bool| -> u64 {
        let wanted = arrivals.clone().filter(|(counter, _)| counter.starts_with("drop_") == dropped);
        wanted.map(|(_, count)| count).sum()
    };
    LinkLine {
        peer: labels.of(link.peer),
        role: link.role.as_str(),
        state: if link.carrier && link.answers { "up" } else { "down" },
        via: text(&link.via),
        address: text(&link.address),
        plane: link.plane.clone(),
        rtt_us: Some(link.rtt_us),
        age_s: Some(link.age_s),
        sent: link.sent,
        arrived: sum(false),
        dropped: sum(true),
        refused: link.errors_received.values().sum(),
        reason: match (link.carrier, link.answers) {
            (false, _) => Some("no carrier".into()),
            (true, false) => Some("no answer".into()),
            (true, true) => None,
        },
    }
}

/// Returns the busiest names first, then those with a label.
fn name_lines(status: &StatusReply, names: &NamesInUse, labels: &Labels) -> Bounded<NameLine> {
    let busiest: BTreeMap<Name, u64> = status.busiest.iter().map(|busy| (busy.name, busy.frames)).collect();
    let mut all: BTreeMap<Name, Roles> = names.roles.clone();
    for name in busiest.keys() {
        all.entry(*name).or_default();
    }
    let is_endpoint = |roles: &Roles| names.is_complete && roles.is_unused();
    let total = status.rib.as_ref().map_or(status.fib.names, |rib| rib.names).max(all.len());
    let mut rows: Vec<_> = all.into_iter().map(|(name, roles)| (busiest.get(&name).copied(), name, roles)).collect();
    // Names of endpoints, which have no records, come last.
    rows.sort_by_key(|(frames, name, roles)| {
        (is_endpoint(roles), std::cmp::Reverse(*frames), !labels.0.contains_key(name), *name)
    });
    rows.truncate(MAX_ROWS);
    let more = total - rows.len();
    let some = |entities: &[Name]| Bounded::new(entities.iter().map(|entity| labels.of(*entity)), MAX_ENTITIES);
    let line = |(frames, name, roles): (Option<u64>, Name, Roles)| NameLine {
        name: labels.of(name),
        writers: some(&roles.writers),
        readers: some(&roles.readers),
        kind: match roles.is_service {
            _ if is_endpoint(&roles) => "endpoint",
            // The FIB does not know it, nor a part of the RIB.
            _ if names.attached.is_none() || roles.is_unused() => "–",
            true => "service",
            false => "topic",
        },
        frames,
    };
    Bounded { rows: rows.into_iter().map(line).collect(), more }
}

fn domains(status: &StatusReply, topology: &TopologyReply, peers: &PeersReply, labels: &Labels) -> Bounded<DomainLine> {
    let mut lines = Vec::new();
    let mut seen = BTreeSet::new();
    if let Some(domain) = &status.domain {
        seen.insert(domain.name);
        lines.push(DomainLine {
            domain: labels.of(domain.name),
            kind: "own",
            state: if domain.error.is_none() { "up" } else { "down" },
            until: domain.not_after,
            detail: match &domain.error {
                Some(error) => text(error),
                None if domain.members_only => "members only".into(),
                None => "open to strangers".into(),
            },
        });
    }
    for tier in status.tiers.iter().flatten() {
        seen.insert(tier.domain);
        let detail = match &tier.reason {
            Some(reason) => text(reason),
            None => format!("{} names in, {} out", tier.entries_in, tier.entries_out),
        };
        let (domain, kind, state) = (labels.of(tier.domain), tier.kind.as_str(), tier.state.as_str());
        lines.push(DomainLine { domain, kind, state, until: None, detail });
    }
    for peer in &peers.peers {
        let Some(domain) = peer.domain.filter(|domain| seen.insert(*domain)) else { continue };
        let detail = format!("border {:#}", peer.peer);
        let (domain, state) = (labels.of(domain), peer.link.as_str());
        lines.push(DomainLine { domain, kind: "peer", state, until: peer.until, detail });
    }
    let borders = topology.switches.iter().flat_map(|switch| switch.borders.iter().map(move |b| (switch.switch, b)));
    for (switch, border) in borders {
        if seen.insert(border.domain) {
            let (domain, detail) = (labels.of(border.domain), format!("border of {switch:#}"));
            lines.push(DomainLine { domain, kind: "peer", state: "up", until: None, detail });
        }
    }
    Bounded::new(lines, MAX_ROWS)
}

/// Returns the members that need a look first.
pub fn robots(output: &RobotsOutput, labels: &Labels) -> Bounded<RobotLine> {
    let mut lines: Vec<RobotLine> = output
        .members
        .iter()
        .map(|member| RobotLine {
            label: text(&member.label),
            state: member.state,
            entity: member.entity.map(|entity| Labelled { label: None, ..labels.of(entity) }),
            expose: text(&member.expose.join(" ")),
            import: text(&member.import.join(" ")),
            read: text(&member.read.join(" ")),
            until: Some(member.until).filter(|until| *until > 0),
            renews: member.until < member.renews_until,
        })
        .collect();
    let order = |state: &str| ["offline", "pending", "online", "joined", "invited"].iter().position(|s| *s == state);
    lines.sort_by_key(|line| (order(line.state).unwrap_or(usize::MAX), line.label.clone()));
    Bounded::new(lines, MAX_ROWS)
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/web/view.rs"]
mod tests;
