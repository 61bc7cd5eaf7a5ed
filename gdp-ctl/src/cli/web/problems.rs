//! What an operator has to look at, the worst first.

use gdp_proto::admin::links::PeersReply;
use gdp_proto::admin::status::{StatusReply, Warning};
use gdp_proto::admin::topology::TopologyReply;
use gdp_proto::admin::words::{PeerLink, TierState};

use super::snapshot::{Labelled, Labels, Problem, Severity, text};
use crate::cli::home::RobotsOutput;

/// Time before the end of a membership from which on it is a problem: 7 days.
const EXPIRY: u64 = 7 * 86400;

/// Returns the problems of a daemon that answers, at `now` in Unix seconds.
pub fn find(
    status: &StatusReply,
    topology: &TopologyReply,
    peers: &PeersReply,
    labels: &Labels,
    now: u64,
) -> Vec<Problem> {
    let mut found = Vec::new();
    let mut add = |severity, what: String| found.push(Problem { severity, what: text(&what) });
    let called = |name| match labels.of(name) {
        Labelled { label: Some(label), short, .. } => format!("{label} ({short})"),
        labelled => labelled.short,
    };
    if !status.control.ready {
        let reason = status.control.reason.as_deref().unwrap_or("no reason is known");
        add(Severity::Down, format!("The RIB cannot be reached: {reason}"));
    }
    for switch in topology.switches.iter().filter(|switch| switch.cost.is_none() && switch.switch != topology.own) {
        add(Severity::Down, format!("No path to switch {}", called(switch.switch)));
    }
    for peer in peers.peers.iter().filter(|peer| peer.link != PeerLink::Up) {
        let reason = peer.reason.as_deref().unwrap_or("the peer is silent");
        let severity = if peer.link == PeerLink::Down { Severity::Down } else { Severity::Warning };
        add(severity, format!("No link to {}: {reason}", called(peer.peer)));
    }
    for link in status.links.iter().filter(|link| !link.carrier) {
        add(Severity::Down, format!("No carrier at {}, on the link to {}", link.via, called(link.peer)));
    }
    for link in status.links.iter().filter(|link| link.carrier && !link.answers) {
        add(Severity::Down, format!("No answer at {}, on the link to {}", link.via, called(link.peer)));
    }
    for tier in status.tiers.iter().flatten().filter(|tier| matches!(tier.state, TierState::Lost | TierState::Refused))
    {
        let reason = tier.reason.as_deref().unwrap_or("no reason is known");
        add(Severity::Down, format!("The {} domain {} is {}: {reason}", tier.kind, called(tier.domain), tier.state));
    }
    for error in &status.errors {
        add(Severity::Down, error.clone());
    }
    if let Some(domain) = &status.domain {
        if let Some(error) = &domain.error {
            add(Severity::Down, format!("The membership does not hold: {error}"));
        }
        match domain.not_after {
            Some(until) if until < now => add(Severity::Down, "The membership of this switch has ended".into()),
            Some(until) if until < now + EXPIRY => {
                let hours = (until - now) / 3600;
                add(Severity::Warning, format!("The membership of this switch ends in {hours} h"));
            }
            _ => {}
        }
    }
    for switch in &topology.switches {
        for neighbour in switch.neighbours.iter().filter(|neighbour| neighbour.silent) {
            let what = format!("The daemon of {} does not answer; its data plane does", called(neighbour.switch));
            add(Severity::Warning, what);
        }
    }
    for refusal in &status.refused {
        let times = if refusal.count == 1 { String::new() } else { format!(" ({} times)", refusal.count) };
        let what = format!("Refused a {} of {}{times}: {}", refusal.what, called(refusal.peer), refusal.reason);
        add(Severity::Warning, what);
    }
    for warning in &status.warnings {
        add(
            Severity::Warning,
            match warning {
                Warning::Silent { entity, names, for_s } => {
                    format!("{} has sent nothing for {for_s} s, and {names} of its names have readers", called(*entity))
                }
                Warning::NotServed { count, names } => {
                    let first = names.first().map_or_else(String::new, |name| format!(", such as {}", called(*name)));
                    format!("{count} names have readers and nobody publishes them{first}")
                }
                Warning::Open => "This switch is of no domain: every endpoint that reaches it gets a link".into(),
                Warning::SmallMtu { interface, mtu, needed } => {
                    format!("{interface} has an MTU of {mtu}, and links need {needed}")
                }
            },
        );
    }
    let mut seen = std::collections::BTreeSet::new();
    found.retain(|problem| seen.insert(problem.what.clone()));
    found
}

/// Returns the problems of members.
pub fn of_members(robots: &RobotsOutput) -> impl Iterator<Item = Problem> {
    robots.members.iter().filter_map(|member| {
        let label = text(&member.label);
        let (severity, what) = match member.state {
            "offline" => (Severity::Down, format!("{label} is offline")),
            "pending" => (Severity::Warning, format!("{label} asks to join: `gdp-ctl approve {label}`")),
            _ => return None,
        };
        Some(Problem { severity, what })
    })
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/web/problems.rs"]
pub(super) mod tests;
