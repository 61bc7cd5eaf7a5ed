//! Traces that continue in other domains.
//!
//! The border with the link asks its peer in the next domain, and measures the round-trip time in
//! the data plane. The peer traces the name inside its domain with probes. Its borders ask further
//! domains. The rules are in [`gdp_rib::crossing`].

use std::time::{Duration, Instant};

use futures::future::join_all;
use gdp_link::link::Link;
use gdp_proto::control::{Crossing, Request, Response, TraceLeg, TraceOn, TracedDomain, TracedEnd, TracedSwitch};
use gdp_wire::Name;
use gdp_wire::header::INITIAL_HOP_LIMIT;
use tokio::time::timeout_at;

use super::core::follow_up::{FollowUp, TraceEntry, Tracing};
use super::core::relay::onward;
use super::daemon::Daemon;
use super::trace::Hop;
use crate::config::Inside;
use gdp_rib::crossing::{Walk, composed, inside, only, path_on, refused, taken};

/// The time limit of a whole trace. It is shorter than that of a request over a link.
const TIMEOUT: Duration = Duration::from_millis(4500);

/// The time that each hop subtracts from the limit for its own transmission.
const MARGIN: Duration = Duration::from_millis(100);

/// The maximum number of echoes or probes per switch without an answer.
const TRIES: usize = 2;

/// The number of consecutive silent switches after which the trace stops.
const SILENT: usize = 2;

impl Daemon {
    /// Continues the trace of a name over a border link of this domain into another one.
    pub(super) async fn trace_beyond(&self, name: Name, border: Name, beyond: (Name, Name)) -> Vec<TracedDomain> {
        let home = self.core().membership.home();
        match home {
            Some(home) => self.beyond(name, border, beyond, (&[], home), Instant::now() + TIMEOUT).await,
            None => only(beyond.0, beyond.1, refused("this switch is a member of no domain")),
        }
    }

    pub(super) async fn trace_on(&self, tracing: Tracing) -> Response {
        let domains = match tracing {
            Tracing::Leaves { link, domain, request } => self.across(&link, domain, request).await,
            Tracing::Enters(entry) => self.within(entry).await,
        };
        Response::TracedOn { domains }
    }

    /// Returns the trace of the domains behind a border of this domain, as that border reports it.
    async fn beyond(
        &self,
        name: Name,
        border: Name,
        (domain, peer): (Name, Name),
        (path, home): (&[Name], Name),
        until: Instant,
    ) -> Vec<TracedDomain> {
        let path = match path_on(path, home, &domain) {
            Ok(path) => path,
            Err(crossing) => return only(domain, peer, crossing),
        };
        let leg = TraceLeg::Out { domain, peer };
        let request = TraceOn { leg, name, path, within_ms: within(until) };
        let next = {
            let core = self.core();
            match border == core.name() {
                true => core.trace_leaves(request),
                false => match core.link_toward(&border) {
                    Ok(link) => FollowUp::Forward(link, onward(border, Request::TraceOn(request))),
                    Err(refusal) => FollowUp::Answer(refusal.into()),
                },
            }
        };
        let response = match next {
            FollowUp::Trace(tracing) => match *tracing {
                Tracing::Leaves { link, domain, request } => return self.across(&link, domain, request).await,
                Tracing::Enters(_) => None,
            },
            FollowUp::Forward(link, request) => asked(&link, &request, until).await,
            FollowUp::Answer(response) => Some(response),
            _ => None,
        };
        answered(domain, peer, response)
    }

    /// Returns the trace that the border at the other end of a link reports, and measures the
    /// round-trip time to it.
    async fn across(&self, link: &Link, domain: Name, request: TraceOn) -> Vec<TracedDomain> {
        let (peer, until) = (link.peer().name, deadline(&request));
        let asks = Request::TraceOn(TraceOn { leg: TraceLeg::Across, within_ms: within(until), ..request });
        let (time, response) = tokio::join!(timeout_at(until.into(), self.distance(peer)), asked(link, &asks, until));
        let mut domains = answered(domain, peer, response);
        if let Some(first) = domains.first_mut() {
            first.rtt_us = time.ok().flatten().map(|time| time.as_micros() as u64);
        }
        domains
    }

    async fn distance(&self, peer: Name) -> Option<Duration> {
        for _ in 0..TRIES {
            if let Some(time) = self.echo(peer).await.ok()? {
                return Some(time);
            }
        }
        None
    }

    /// Traces the path of a name through this domain and beyond.
    async fn within(&self, entry: TraceEntry) -> Vec<TracedDomain> {
        let TraceEntry { request, home, asked_by, from, may_cross, visibility, egress } = entry;
        let (own, name, until) = (self.name, request.name, deadline(&request));
        let shows_switches = visibility == Inside::Open;
        // Use half of the time here, so that the other domains have the rest.
        let half = Instant::now() + until.saturating_duration_since(Instant::now()) / 2;
        let walks = join_all(egress.iter().map(|to| self.walk(asked_by, name, *to, shows_switches, half))).await;
        let (walks, ends): (Vec<Walk>, Vec<Option<TracedEnd>>) = walks.into_iter().unzip();
        let leaves = egress.iter().zip(&ends).flat_map(|(border, end)| {
            let beyond = end.iter().flat_map(|end| &end.beyond).filter(|_| may_cross);
            beyond.filter(move |(_, peer)| (*border, *peer) != (own, from)).map(|beyond| (*border, *beyond))
        });
        let path = (&request.path[..], home);
        let beyond = join_all(leaves.map(|(border, beyond)| self.beyond(name, border, beyond, path, until))).await;
        let crossing = inside(walks, shows_switches);
        composed(TracedDomain { depth: 1, domain: home, entry: own, rtt_us: None, crossing }, beyond)
    }

    /// Traces the path to an egress switch of this domain. Lists the switches on it only if `lists`
    /// is set.
    async fn walk(
        &self,
        asked_by: Name,
        name: Name,
        egress: Name,
        lists: bool,
        until: Instant,
    ) -> (Walk, Option<TracedEnd>) {
        let mut walk = Walk::default();
        if egress == self.name {
            let end = self.core().switch.end_of(&name);
            walk.end = Some((end.links, Duration::ZERO));
            return (walk, Some(end));
        }
        let (mut hops, mut silent) = (if lists { 1 } else { INITIAL_HOP_LIMIT }, 0);
        loop {
            let hop = timeout_at(until.into(), self.probed(asked_by, name, egress, hops)).await.ok().flatten();
            if lists {
                let (switch, time) = (hop.as_ref().map(|hop| hop.switch), hop.as_ref().map(|hop| hop.time));
                let rtt_us = time.map(|time| time.as_micros() as u64);
                walk.switches.push(TracedSwitch { hop: hops, switch, rtt_us });
            }
            silent = if hop.is_some() { 0 } else { silent + 1 };
            if let Some(Hop { end: Some(end), time, .. }) = hop {
                walk.end = Some((end.links, time));
                return (walk, Some(end));
            }
            if !lists || silent == SILENT || hops >= INITIAL_HOP_LIMIT || Instant::now() >= until {
                return (walk, None);
            }
            hops += 1;
        }
    }

    async fn probed(&self, asked_by: Name, name: Name, egress: Name, hops: u8) -> Option<Hop> {
        for _ in 0..TRIES {
            if let Some(hop) = self.probe(Some(asked_by), name, egress, hops).await.ok()? {
                return Some(hop);
            }
        }
        None
    }
}

/// Returns the answer over a link, or `None` if it misses the deadline or fails.
async fn asked(link: &Link, request: &Request, until: Instant) -> Option<Response> {
    let answer = timeout_at(until.into(), link.request(request)).await.ok()?;
    answer.inspect_err(|error| tracing::debug!(%error, "a trace was not answered")).ok()
}

fn answered(domain: Name, entry: Name, response: Option<Response>) -> Vec<TracedDomain> {
    let crossing = match response {
        Some(Response::TracedOn { domains }) => match taken(domain, entry, domains) {
            Some(domains) => return domains,
            None => refused("it answers what makes no sense"),
        },
        Some(Response::Refused(refusal)) => refused(refusal.reason),
        Some(_) => refused("it answers something else"),
        None => Crossing::Unanswered,
    };
    only(domain, entry, crossing)
}

/// Returns the remaining time for the next hop, in milliseconds.
fn within(until: Instant) -> u32 {
    let left = until.saturating_duration_since(Instant::now()).saturating_sub(MARGIN);
    u32::try_from(left.as_millis()).unwrap_or(u32::MAX)
}

fn deadline(request: &TraceOn) -> Instant {
    Instant::now() + TIMEOUT.min(Duration::from_millis(request.within_ms.into()))
}
