//! Continues a trace into other domains, without I/O. It decides which domain may be asked next and
//! validates and bounds each answer. It also limits the rate at which a neighbour may ask.
//! `gdp-daemon` sends the requests and the answers.

use std::time::Duration;

use gdp_proto::control::{
    Crossing, MAX_PATH, MAX_TRACED_DOMAINS, MAX_TRACED_SWITCHES, Refusal, RefusalCode, TracedDomain, TracedSwitch,
};
use gdp_wire::Name;

/// Burst of trace requests accepted over one link from another domain.
const BURST: u32 = 8;

/// Time in which the allowance for one more trace request refills.
const INTERVAL: Duration = Duration::from_millis(500);

/// Maximum length in bytes of a refusal's reason in a trace.
const MAX_REASON: usize = 256;

/// Rate limit for the requests of the other end of a link.
#[derive(Debug)]
pub struct Allowance {
    burst: u32,
    /// Time in which the allowance for one more request refills.
    interval: Duration,
    /// Time at which the full burst is available again.
    due: Duration,
    refused: u64,
}

impl Default for Allowance {
    /// The allowance for trace requests of another domain.
    fn default() -> Self {
        Self::new(BURST, INTERVAL)
    }
}

impl Allowance {
    pub fn new(burst: u32, interval: Duration) -> Self {
        Self { burst, interval, due: Duration::ZERO, refused: 0 }
    }

    /// Returns whether one more request may be made at `now`, and counts it as refused if not.
    pub fn take(&mut self, now: Duration) -> bool {
        let due = self.due.max(now) + self.interval;
        let may = due - now <= self.burst * self.interval;
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

/// Returns the path to send with a trace request from domain `home` to domain `next`.
///
/// `path` lists the domains before `home`. Fails with [`Crossing::Loop`] if the new path contains
/// `next`, and with [`Crossing::TooFar`] if it is longer than [`MAX_PATH`] domains.
pub fn path_on(path: &[Name], home: Name, next: &Name) -> Result<Vec<Name>, Crossing> {
    let path: Vec<Name> = path.iter().copied().chain([home]).collect();
    match () {
        () if path.contains(next) => Err(Crossing::Loop),
        () if path.len() > MAX_PATH => Err(Crossing::TooFar),
        () => Ok(path),
    }
}

/// Checks the path of a trace request that domain `from` sends to domain `home`.
///
/// The path must hold 1 to [`MAX_PATH`] domains, end with `from` and not contain `home`.
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

/// Returns a trace answer that consists of this one domain.
pub fn only(domain: Name, entry: Name, crossing: Crossing) -> Vec<TracedDomain> {
    vec![TracedDomain { depth: 1, domain, entry, rtt_us: None, crossing }]
}

pub fn refused(reason: impl Into<String>) -> Crossing {
    let mut reason = reason.into();
    reason.truncate(reason.floor_char_boundary(MAX_REASON));
    Crossing::Refused { reason }
}

/// Validates and bounds the trace answer of `domain`, which the trace enters at switch `entry`.
///
/// The first entry is always attributed to `domain` and `entry`. Returns `None` if the answer is
/// empty or its depths are not consistent.
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

/// Composes a domain's trace answer from its own entry and the answers of the domains behind it.
pub fn composed(own: TracedDomain, beyond: Vec<Vec<TracedDomain>>) -> Vec<TracedDomain> {
    let behind = beyond.into_iter().flatten().map(|said| TracedDomain { depth: said.depth.saturating_add(1), ..said });
    let reachable = behind.filter(|said| usize::from(said.depth) <= MAX_PATH);
    let mut domains: Vec<TracedDomain> = [own].into_iter().chain(reachable).take(MAX_TRACED_DOMAINS).collect();
    let mut room = MAX_TRACED_SWITCHES;
    domains.iter_mut().for_each(|said| bound(&mut said.crossing, &mut room));
    domains
}

/// Bounds one crossing: hides a switch list that exceeds the remaining room, and truncates a
/// reason.
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

/// Result of probing the path to one egress switch.
#[derive(Debug, Default)]
pub struct Walk {
    pub switches: Vec<TracedSwitch>,
    /// Number of links to endpoints at the egress switch, and the time to reach it. `None` if the
    /// switch has not answered.
    pub end: Option<(u32, Duration)>,
}

/// Composes a domain's own crossing from the probed paths to its egress switches.
///
/// The switches are listed only if `shows_switches` is set.
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
