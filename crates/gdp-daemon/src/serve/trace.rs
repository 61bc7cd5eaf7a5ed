//! Probes, sent and answered: where a name leads, who is on the way, and how long that takes. A
//! probe goes in the data plane; its answer comes back over the links of switches, hop by hop. And
//! echoes, which neighbours answer in their data planes.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_core::crypto;
use gdp_core::name::NamePrefix;
use gdp_link::link::Link;
use gdp_proto::control::{MAX_BEYOND, Request, Traced, TracedEnd};
use gdp_wire::table::EGRESS_SET_SIZE;
use gdp_wire::{Header, LinkRole, Name};
use tokio::sync::oneshot;
use tokio::time::timeout;

use super::Daemon;
use super::control::onward;
use super::core::Core;
use super::crossing::MAX_EGRESS;
use crate::domain::Relationship;
use gdp_dataplane::notices::Punted;

/// How long an answer may take.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Probes for this domain's own people that wait for their answers at once.
const MAX_OUTSTANDING: usize = 64;

/// The same for each neighbouring domain, besides: two of its traces.
const MAX_FOR_NEIGHBOUR: usize = 2 * MAX_EGRESS;

/// Those who wait for answers to probes. Each domain has its share: what others trace here keeps
/// nobody else from it.
#[derive(Default)]
pub struct Outstanding(HashMap<u64, Waiting>);

struct Waiting {
    /// The neighbouring domain that asked; none for this one.
    asked_by: Option<Name>,
    answer: oneshot::Sender<(Traced, Instant)>,
}

impl Outstanding {
    /// How many more there may be for a neighbouring domain, or this one. Of those that nobody
    /// waits for any more none counts.
    pub fn room(&mut self, asked_by: Option<Name>) -> usize {
        self.0.retain(|_, waiting| !waiting.answer.is_closed());
        let held = self.0.values().filter(|waiting| waiting.asked_by == asked_by).count();
        share(asked_by).saturating_sub(held)
    }

    /// An answer with this cookie is waited for from now on, until the receiver is dropped.
    fn wait(
        &mut self,
        asked_by: Option<Name>,
        cookie: u64,
    ) -> Result<oneshot::Receiver<(Traced, Instant)>, ProbeError> {
        if self.room(asked_by) == 0 {
            return Err(ProbeError::Busy(share(asked_by)));
        }
        let (answer, waiting) = oneshot::channel();
        self.0.insert(cookie, Waiting { asked_by, answer });
        Ok(waiting)
    }

    fn answer(&mut self, answer: Traced) {
        if let Some(waiting) = self.0.remove(&answer.cookie) {
            // Whoever asked may have given up.
            let _ = waiting.answer.send((answer, Instant::now()));
        }
    }
}

fn share(asked_by: Option<Name>) -> usize {
    if asked_by.is_some() { MAX_FOR_NEIGHBOUR } else { MAX_OUTSTANDING }
}

/// Why there is nothing to probe.
#[derive(Debug, thiserror::Error)]
pub enum ProbeError {
    #[error("this switch knows no name that begins with {0}")]
    Unknown(NamePrefix),
    #[error("several names begin with {0}; give more of its digits")]
    Ambiguous(NamePrefix),
    #[error(
        "this switch knows no way to {0:#}: it is no switch, has no link here, and nobody attached here may send to \
         it; ask at a switch \
         where somebody is who does"
    )]
    NoWay(Name),
    #[error("there is no path to switch {0:#} now")]
    NoPath(Name),
    #[error("there is no link to {0:#} now")]
    NoLink(Name),
    #[error("{0} probes wait for their answers already; try again")]
    Busy(usize),
    #[error("no random number for a cookie: {0}")]
    Random(String),
}

/// Where a name is, as this switch sees it.
pub struct Location {
    pub name: Name,
    /// Echoes reach it by a link of this switch.
    pub is_near: bool,
    /// The egress switches of the name; of a switch, itself.
    pub egress: Vec<Name>,
}

/// The answer to a probe, and the time it took.
pub struct Hop {
    pub switch: Name,
    pub end: Option<TracedEnd>,
    pub time: Duration,
}

/// Answers probes that end at this switch, until the daemon ends. An answer that is lost is as a
/// probe that is lost.
pub async fn run(daemon: Arc<Daemon>) {
    let notices = daemon.core().planes.notices().clone();
    loop {
        let probe = notices.probe().await;
        let answer = daemon.core().answer_to(&probe);
        let Some((link, answer)) = answer else {
            tracing::debug!(source = %format_args!("{:#}", probe.source), "a probe to which no answer leads back");
            continue;
        };
        daemon.spawn(async move {
            if let Err(error) = link.request(&answer).await {
                tracing::debug!(%error, "an answer to a probe was lost");
            }
        });
    }
}

impl Daemon {
    /// Sends a probe for `name` toward an egress switch, `hops` switches far at most, and waits for
    /// its answer. `None`: there was none. `asked_by`: the neighbouring domain it is for.
    pub(super) async fn probe(
        &self,
        asked_by: Option<Name>,
        name: Name,
        switch: Name,
        hops: u8,
    ) -> Result<Option<Hop>, ProbeError> {
        let sent = Instant::now();
        let answer = self.core().send_probe(asked_by, name, switch, hops)?;
        let answer = timeout(TIMEOUT, answer).await.ok().and_then(Result::ok);
        Ok(answer.map(|(Traced { switch, end, .. }, at)| Hop { switch, end, time: at - sent }))
    }

    /// Asks the data plane of a neighbour for an answer; the time that took. `None`: there was
    /// none.
    pub(super) async fn echo(&self, peer: Name) -> Result<Option<Duration>, ProbeError> {
        let cookie = cookie()?;
        let (id, notices, sent) = {
            let core = self.core();
            let id = core.link_to(&peer).ok_or(ProbeError::NoLink(peer))?.local_id();
            let sent = Instant::now();
            core.planes.ask(id, cookie);
            (id, core.planes.notices().clone(), sent)
        };
        let answered = timeout(TIMEOUT, notices.answered_with(id, cookie)).await;
        Ok(answered.ok().map(|()| sent.elapsed()))
    }
}

impl Core {
    /// The one name that begins so, of those this switch knows, and where it is.
    pub(super) fn locate(&self, prefix: &NamePrefix) -> Result<Location, ProbeError> {
        let name = match prefix.full() {
            Some(name) => name,
            None => self.known_name(prefix)?,
        };
        let is_near = self.link_to(&name).is_some();
        let paths = self.topology.paths();
        let egress: Vec<Name> = if name == self.name() || paths.reaches(&name) {
            vec![name]
        } else {
            let bits = self.planes.route(&name).map_or(0, |entry| entry.egress_bits);
            let of = |bit: u8| (bits >> bit & 1 != 0).then(|| paths.bits.get(&bit).copied()).flatten();
            (0..EGRESS_SET_SIZE as u8).filter_map(of).collect()
        };
        if egress.is_empty() && !is_near {
            Err(ProbeError::NoWay(name))
        } else {
            Ok(Location { name, is_near, egress })
        }
    }

    fn known_name(&self, prefix: &NamePrefix) -> Result<Name, ProbeError> {
        let switches = self.topology.states().map(|state| state.switch).chain([self.name()]);
        let near = switches.chain(self.links.values().map(|state| state.link.peer().name));
        let mut found: BTreeSet<Name> = near.filter(|name| prefix.matches(name)).collect();
        found.extend(self.planes.names_like(prefix, 2));
        let mut found = found.into_iter();
        match (found.next(), found.next()) {
            (Some(name), None) => Ok(name),
            (None, _) => Err(ProbeError::Unknown(prefix.clone())),
            _ => Err(ProbeError::Ambiguous(prefix.clone())),
        }
    }

    /// What this switch delivers a name to; nothing if it is no egress switch of the name.
    pub(super) fn end_of(&self, name: &Name) -> TracedEnd {
        let mut end = TracedEnd::default();
        let Some(entry) = self.planes.route(name) else { return end };
        for id in self.planes.readers(&entry) {
            match self.links.get(&id).map(|state| (&state.admission.standing, state.link.peer().name)) {
                Some((Relationship::Border { domain, .. }, switch)) if end.beyond.len() < MAX_BEYOND => {
                    end.beyond.push((*domain, switch));
                }
                Some((Relationship::Border { .. }, _)) => {}
                _ => end.links += 1,
            }
        }
        end
    }

    /// An answer has come to a probe of this switch.
    pub(super) fn probe_answered(&mut self, answer: Traced) {
        self.outstanding.answer(answer);
    }

    /// The answer to a probe that ended here, and by which link it goes; none if it came from
    /// another domain, to which the inside of this one is hidden and no answer leads, or there is
    /// no way back.
    fn answer_to(&self, probe: &Punted) -> Option<(Link, Request)> {
        if self.links.get(&probe.link)?.role() != LinkRole::Switch as u32 {
            return None;
        }
        let own_bit = self.routes.own_bit().map_or(0, |bit| 1u64 << bit);
        let end = (probe.egress_bits == own_bit).then(|| self.end_of(&probe.destination));
        let answer = Traced { cookie: probe.cookie, switch: self.name(), end };
        Some((self.link_toward(&probe.source).ok()?, onward(probe.source, Request::Traced(answer))))
    }

    fn send_probe(
        &mut self,
        asked_by: Option<Name>,
        name: Name,
        switch: Name,
        hops: u8,
    ) -> Result<oneshot::Receiver<(Traced, Instant)>, ProbeError> {
        let bit = self.topology.paths().bit(&switch).ok_or(ProbeError::NoPath(switch))?;
        let link = self.planes.next_hop(bit);
        if link == 0 {
            return Err(ProbeError::NoPath(switch));
        }
        let cookie = cookie()?;
        let answer = self.outstanding.wait(asked_by, cookie)?;
        self.planes.probe(link, Header::probe(name, self.name(), bit, hops.max(1)), cookie);
        Ok(answer)
    }
}

fn cookie() -> Result<u64, ProbeError> {
    crypto::random().map(u64::from_ne_bytes).map_err(|error| ProbeError::Random(error.to_string()))
}

#[cfg(test)]
#[path = "../../tests/unit/serve/trace.rs"]
mod tests;
