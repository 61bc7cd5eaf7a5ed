//! How a trace goes on in other domains, without I/O: which domain may be asked next, what of its answer is taken, and how often a
//! neighbour may ask. [`crate::serve::crossing`] asks and answers.

use std::time::Duration;

use gdp::control::{
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

/// What `domain` has answered, which is entered at switch `entry`: cut to the bounds, and said to be of nobody else. None: it is no answer.
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
mod tests {
    use super::*;

    #[test]
    fn no_domain_is_entered_twice_and_no_more_than_the_budget() {
        let ways: Vec<Name> = (0..=MAX_PATH as u8).map(name).collect();
        let mut path = Vec::new();
        for pair in ways.windows(2) {
            path = path_on(&path, pair[0], &pair[1]).unwrap();
            assert!(check_path(&path, &pair[0], &pair[1]).is_ok());
            assert_eq!(path_on(&path, pair[1], &pair[0]), Err(Crossing::Loop), "where it came from");
            assert_eq!(path_on(&path, pair[1], &ways[0]), Err(Crossing::Loop), "where it began");
            assert_eq!(path_on(&path, pair[1], &pair[1]), Err(Crossing::Loop), "where it is");
        }
        assert_eq!(path.len(), MAX_PATH);
        assert_eq!(path_on(&path, name(MAX_PATH as u8), &name(99)), Err(Crossing::TooFar));
    }

    #[test]
    fn a_path_ends_with_who_asks() {
        let (home, from, third) = (name(1), name(2), name(3));
        for (path, needle) in [
            (vec![], "path of 0"),
            (vec![from; MAX_PATH + 1], "path of 17"),
            (vec![third], "does not end with"),
            (vec![home, from], "already"),
        ] {
            let refusal = check_path(&path, &from, &home).expect_err(needle);
            assert!(refusal.reason.contains(needle), "{refusal}");
        }
        assert!(check_path(&[third, from], &from, &home).is_ok());
    }

    #[test]
    fn what_a_domain_answers_is_bounded_and_of_itself() {
        let (domain, entry) = (name(1), name(2));
        let said = |depth, crossing| TracedDomain { depth, domain: name(9), entry: name(9), rtt_us: None, crossing };
        let depths = |depths: &[u8]| depths.iter().map(|depth| said(*depth, Crossing::Unanswered)).collect();
        let of = |answer| taken(domain, entry, answer);
        for wrong in [&[][..], &[0], &[2], &[1, 1], &[1, 3], &[1, 2, 0]] {
            assert!(of(depths(wrong)).is_none(), "{wrong:?}");
        }
        let answer = of(depths(&[1, 2, 3, 2])).unwrap();
        assert_eq!((answer[0].domain, answer[0].entry, answer[1].domain), (domain, entry, name(9)));
        let deep: Vec<u8> = (1..=MAX_PATH as u8 + 1).collect();
        assert!(of(depths(&deep)).is_none());
        assert_eq!(of(depths(&[&[1][..], &[2; 99]].concat())).unwrap().len(), MAX_TRACED_DOMAINS);

        let switches = |count| {
            let switch = TracedSwitch { hop: 1, switch: None, rtt_us: None };
            Crossing::Traced { links: 0, time_us: None, switches: Some(vec![switch; count]) }
        };
        let masked = Crossing::Traced { links: 0, time_us: None, switches: None };
        let answer = of(vec![
            said(1, switches(MAX_TRACED_SWITCHES - 1)),
            said(2, switches(2)),
            said(2, switches(1)),
            said(2, Crossing::Refused { reason: "é".repeat(1000) }),
        ]);
        let answer = answer.unwrap();
        assert_eq!([&answer[1].crossing, &answer[2].crossing], [&masked, &switches(1)], "as long as there is room");
        assert!(matches!(&answer[3].crossing, Crossing::Refused { reason } if reason.len() == MAX_REASON));
    }

    #[test]
    fn the_largest_answer_fits_a_message() {
        let full = || TracedDomain {
            depth: 1,
            domain: name(255),
            entry: name(255),
            rtt_us: Some(u64::MAX),
            crossing: refused("x".repeat(MAX_REASON)),
        };
        let switch = TracedSwitch { hop: 255, switch: Some(name(255)), rtt_us: Some(u64::MAX) };
        let switches = Some(vec![switch; MAX_TRACED_SWITCHES]);
        let crossing = Crossing::Traced { links: u32::MAX, time_us: Some(u64::MAX), switches };
        let domains = composed(TracedDomain { crossing, ..full() }, vec![vec![full(); 99]]);
        assert_eq!((domains.len(), domains[1].depth), (MAX_TRACED_DOMAINS, 2));
        assert!(matches!(&domains[0].crossing, Crossing::Traced { switches: Some(_), .. }));
        gdp::control::encode(&gdp::control::Response::TracedOn { domains }).unwrap();
    }

    #[test]
    fn the_slowest_way_counts_and_one_that_does_not_answer_hides_it() {
        let to = |links, millis| Walk { switches: vec![], end: Some((links, Duration::from_millis(millis))) };
        let traced = |links, time_us| Crossing::Traced { links, time_us, switches: None };
        assert_eq!(inside(vec![to(1, 2), to(2, 1)], false), traced(3, Some(2000)));
        assert_eq!(inside(vec![to(1, 2), Walk::default()], false), traced(1, None));
        assert!(matches!(inside(vec![], true), Crossing::Traced { links: 0, switches: Some(_), .. }));
    }

    #[test]
    fn a_neighbour_may_ask_so_often() {
        let (mut allowance, start) = (Allowance::default(), Duration::from_secs(100));
        let granted = (0..20).filter(|_| allowance.take(start)).count();
        assert_eq!((granted, allowance.refused()), (BURST as usize, 20 - u64::from(BURST)));
        assert!(!allowance.take(start + INTERVAL - Duration::from_millis(1)));
        assert!(allowance.take(start + INTERVAL) && !allowance.take(start + INTERVAL));
    }

    fn name(i: u8) -> Name {
        Name::from_bytes([i; 32])
    }
}
