//! How a trace goes on in other domains, without I/O: which domain may be asked next, what of its
//! answer is taken, and how often a neighbour may ask. `gdp-daemon` asks and
//! answers.

use std::time::Duration;

use gdp_proto::control::{
    Crossing, MAX_PATH, MAX_TRACED_DOMAINS, MAX_TRACED_SWITCHES, Refusal, RefusalCode, TracedDomain, TracedSwitch,
};
use gdp_wire::Name;

/// Traces that may come over a link into another domain at once.
const BURST: u32 = 8;

/// The time after which there may be one more.
const INTERVAL: Duration = Duration::from_millis(500);

/// Longest reason that is passed on, in bytes.
const MAX_REASON: usize = 256;

/// How often the other end of a link may ask for traces.
#[derive(Debug, Default)]
pub struct Allowance {
    /// When all of it will be there again.
    due: Duration,
    refused: u64,
}

impl Allowance {
    /// Whether one more may be made now; if not, that is counted.
    pub fn take(&mut self, now: Duration) -> bool {
        let due = self.due.max(now) + INTERVAL;
        let may = due - now <= BURST * INTERVAL;
        if may {
            self.due = due;
        } else {
            self.refused += 1;
        }
        may
    }

    pub fn refused(&self) -> u64 {
        self.refused
    }
}

/// The path to show domain `next` when it is asked by `home`, which `path` leads to.
pub fn path_on(path: &[Name], home: Name, next: &Name) -> Result<Vec<Name>, Crossing> {
    let path: Vec<Name> = path.iter().copied().chain([home]).collect();
    match () {
        () if path.contains(next) => Err(Crossing::Loop),
        () if path.len() > MAX_PATH => Err(Crossing::TooFar),
        () => Ok(path),
    }
}

/// Whether a path may lead from domain `from` into `home`.
pub fn check_path(path: &[Name], from: &Name, home: &Name) -> Result<(), Refusal> {
    let (1..=MAX_PATH, Some(last)) = (path.len(), path.last()) else {
        let reason = format!("a path of {} domains, where 1 to {MAX_PATH} are allowed", path.len());
        return Err(Refusal::new(RefusalCode::Malformed, reason));
    };
    if last != from {
        return Err(Refusal::new(RefusalCode::Malformed, "the path does not end with the domain that asks"));
    }
    if path.contains(home) {
        return Err(Refusal::new(RefusalCode::Malformed, format!("domain {home:#} is on the path already")));
    }
    Ok(())
}

/// A domain from which there is nothing but this.
pub fn only(domain: Name, entry: Name, crossing: Crossing) -> Vec<TracedDomain> {
    vec![TracedDomain { depth: 1, domain, entry, rtt_us: None, crossing }]
}

pub fn refused(reason: impl Into<String>) -> Crossing {
    let mut reason = reason.into();
    reason.truncate(reason.floor_char_boundary(MAX_REASON));
    Crossing::Refused { reason }
}

/// What `domain` has answered, which is entered at switch `entry`: cut to the bounds, and said to
/// be of nobody else. None: it is no answer.
pub fn taken(domain: Name, entry: Name, answer: Vec<TracedDomain>) -> Option<Vec<TracedDomain>> {
    let (mut depth, mut room) = (0, MAX_TRACED_SWITCHES);
    let mut domains: Vec<TracedDomain> = answer.into_iter().take(MAX_TRACED_DOMAINS).collect();
    for (i, said) in domains.iter_mut().enumerate() {
        let deepest = if i == 0 { 1 } else { MAX_PATH.min(depth + 1) };
        let least = if i == 0 { 1 } else { 2 };
        if !(least..=deepest).contains(&usize::from(said.depth)) {
            return None;
        }
        depth = said.depth.into();
        bound(&mut said.crossing, &mut room);
    }
    let first = domains.first_mut()?;
    (first.domain, first.entry) = (domain, entry);
    Some(domains)
}

/// What a domain answers of itself and of those behind it.
pub fn composed(own: TracedDomain, beyond: Vec<Vec<TracedDomain>>) -> Vec<TracedDomain> {
    let behind = beyond.into_iter().flatten().map(|said| TracedDomain { depth: said.depth.saturating_add(1), ..said });
    let reachable = behind.filter(|said| usize::from(said.depth) <= MAX_PATH);
    let mut domains: Vec<TracedDomain> = [own].into_iter().chain(reachable).take(MAX_TRACED_DOMAINS).collect();
    let mut room = MAX_TRACED_SWITCHES;
    domains.iter_mut().for_each(|said| bound(&mut said.crossing, &mut room));
    domains
}

/// Hides what there is no room for.
fn bound(crossing: &mut Crossing, room: &mut usize) {
    match crossing {
        Crossing::Traced { switches, .. } => {
            let listed = switches.as_ref().map_or(0, Vec::len);
            match room.checked_sub(listed) {
                Some(left) => *room = left,
                None => *switches = None,
            }
        }
        Crossing::Refused { reason } => reason.truncate(reason.floor_char_boundary(MAX_REASON)),
        Crossing::Unanswered | Crossing::Loop | Crossing::TooFar => {}
    }
}

/// The way to one egress switch, as probes have found it.
#[derive(Debug, Default)]
pub struct Walk {
    pub switches: Vec<TracedSwitch>,
    /// Links to endpoints there, and how long the way to it takes; none: it has not answered.
    pub end: Option<(u32, Duration)>,
}

/// What a domain says of itself.
pub fn inside(walks: Vec<Walk>, shows_switches: bool) -> Crossing {
    let links = walks.iter().filter_map(|walk| walk.end).fold(0, |sum: u32, (links, _)| sum.saturating_add(links));
    let times: Option<Vec<Duration>> = walks.iter().map(|walk| Some(walk.end?.1)).collect();
    let time_us = times.map(|times| times.into_iter().max().unwrap_or_default().as_micros() as u64);
    let switches = shows_switches.then(|| walks.into_iter().flat_map(|walk| walk.switches).collect());
    Crossing::Traced { links, time_us, switches }
}

#[cfg(test)]
#[path = "../tests/unit/crossing.rs"]
mod tests;
