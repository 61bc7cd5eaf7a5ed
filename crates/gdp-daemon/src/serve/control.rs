//! Control beyond the first hop: what goes to the RIB goes to the switch that it is beside, what
//! the RIB says to the switch that it is for, each hop by hop over the links of the domain's
//! switches as the topology leads. Whoever passes something on need not know what it is.

use gdp_link::link::Link;
use gdp_proto::control::{EntityRequest, MAX_HOPS, Refusal, RefusalCode, Request, Response};
use gdp_wire::{LinkRole, Name};

use super::core::{Core, Next, refuse};
use super::domain;

/// How far the RIB holds what this switch is to report: that it is there, and who is attached to
/// it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Report {
    #[default]
    Due,
    /// Sent, and not answered; nothing has changed since.
    Sent,
    /// Taken by the RIB beside switch `by`, in this run of its daemon.
    Taken { by: Name, run: u64 },
}

/// A report that is to be sent to the RIB beside the switch `by`, in this run of its daemon.
pub(super) struct Reporting {
    pub by: Name,
    pub run: u64,
    /// The run of the RIB that was followed then.
    pub follows: Option<u64>,
    pub link: Link,
    pub request: Request,
}

impl Core {
    /// The RIB, and that it has taken this switch's report; or why there is none to ask.
    pub fn rib_at(&self) -> Result<Name, Refusal> {
        let own = self.name();
        let unreachable = |why: String| Refusal::new(RefusalCode::Unreachable, why);
        let Some((by, run)) = self.topology.rib() else {
            let stated = self.topology.states().find(|state| state.rib).map(|state| state.switch);
            let why = match (stated, &self.no_rib) {
                (Some(rib), _) => format!("no path to switch {rib}, where it was"),
                (None, Some(why)) => why.clone(),
                (None, None) => "no switch that it knows says that the RIB is there".into(),
            };
            return Err(unreachable(format!("switch {own} has no way to the RIB: {why}")));
        };
        if self.report != (Report::Taken { by, run }) {
            let why =
                format!("switch {own} has no way to the RIB yet: the one at switch {by} has not taken its report");
            return Err(unreachable(why));
        }
        Ok(by)
    }

    /// The link to the next switch on the way to another.
    pub fn link_toward(&self, to: &Name) -> Result<Link, Refusal> {
        let next = self.topology.paths().next.get(to);
        next.and_then(|next| self.link_to(next)).ok_or_else(|| {
            let reason = format!("switch {} knows no path to switch {to}", self.name());
            Refusal::new(RefusalCode::Unreachable, reason)
        })
    }

    /// Asks the RIB, wherever it is.
    pub(super) fn to_rib(&self, request: Request) -> Next {
        let way = self.rib_at().and_then(|rib| Ok((rib, self.link_toward(&rib)?)));
        match way {
            Ok((rib, link)) => Next::Forward(link, onward(rib, request)),
            Err(refusal) => Next::Answer(refusal.into()),
        }
    }

    /// Something that a neighbouring switch passes on: for this switch, for the RIB here, or to be
    /// passed on.
    pub(super) fn passed_on(&mut self, from: &Link, to: Name, hops: u8, request: Request) -> Next {
        let (own, peer) = (self.name(), from.peer().name);
        if self.links.get(&from.local_id()).is_none_or(|state| state.role() != LinkRole::Switch as u32) {
            return refuse(RefusalCode::Unsupported, "nothing of this kind is asked across a border between domains");
        }
        if !self.topology.paths().reaches(&peer) {
            let reason = format!("switch {peer} is not on the map of switch {own} yet; try again in a moment");
            return refuse(RefusalCode::Unreachable, reason);
        }
        if to == own {
            return self.arrived(request);
        }
        let Some(hops) = hops.checked_sub(1) else {
            let reason = format!("no hop is left at switch {own} on the way to switch {to}: the paths lead in a loop");
            return refuse(RefusalCode::Unreachable, reason);
        };
        match self.link_toward(&to) {
            Ok(link) if link.peer().name == peer => {
                let reason =
                    format!("switch {own} gets to switch {to} by switch {peer}, which asks it: the paths change");
                refuse(RefusalCode::Unreachable, reason)
            }
            Ok(link) => Next::Forward(link, Request::Onward { to, hops, request: Box::new(request) }),
            Err(refusal) => Next::Answer(refusal.into()),
        }
    }

    /// Something that has come to where it was to go: from the RIB, or for the one here.
    fn arrived(&mut self, request: Request) -> Next {
        let own = self.name();
        let request = match request {
            Request::Tier(message) => return self.tier_arrived(*message),
            Request::TraceOn(request) => return self.trace_leaves(request),
            Request::Peerings { run, wanted } => {
                let taken = self.set_peerings(run, wanted.into_iter().collect());
                return Next::Answer(taken.map_or_else(Response::from, |()| Response::Done));
            }
            request => request,
        };
        let origin = match &request {
            Request::Fib(push) if push.switch == own => return Next::Answer(self.push(push)),
            Request::Peers(push) if push.switch == own => {
                return match (self.check_fence(push.peers.run), self.link_to(&push.entity)) {
                    (Err(refusal), _) => Next::Answer(refusal.into()),
                    (Ok(()), Some(link)) => Next::Forward(link, request),
                    (Ok(()), None) => refuse(RefusalCode::Unreachable, format!("{} has no link here", push.entity)),
                };
            }
            Request::Detach { switch, entity } if *switch == own => return self.told_to_detach(*entity),
            Request::Traced(answer) => {
                self.probe_answered(answer.clone());
                return Next::Answer(Response::Done);
            }
            Request::Relay { switch, .. } | Request::Detach { switch, .. } | Request::Admitted { switch, .. } => {
                *switch
            }
            Request::Report { switch, .. } => match switch.name() {
                Ok(origin) => origin,
                Err(_) => {
                    return refuse(RefusalCode::Malformed, "the key of the reporting switch is not valid");
                }
            },
            _ => {
                return refuse(
                    RefusalCode::Malformed,
                    "switches pass on what is for the RIB or from it, and this is not",
                );
            }
        };
        if self.rib.is_none() {
            return refuse(RefusalCode::Unreachable, format!("the RIB is not at switch {own}"));
        }
        if !self.topology.paths().reaches(&origin) {
            let reason = format!("switch {origin} is not on the map of the RIB yet; try again in a moment");
            return refuse(RefusalCode::Unreachable, reason);
        }
        self.for_rib(request)
    }

    /// A request of a switch, for the RIB.
    pub(super) fn for_rib(&mut self, request: Request) -> Next {
        let now = self.now();
        let Some(rib) = &mut self.rib else { return self.to_rib(request) };
        Next::Answer(match request {
            Request::Admitted { entity, membership, .. } => {
                return domain::admitted(self.domain.as_mut(), entity, &membership, now.unix);
            }
            Request::Tier(message) => return self.tier_arrived(*message),
            Request::Relay { switch, entity, by_tool, request } => {
                return self.ask_rib(switch, entity.as_ref(), by_tool, &request);
            }
            Request::Report { switch, attached, own_bit, shown } => {
                let response = rib.report(now, &switch, &attached, own_bit);
                if let Some(shown) = shown {
                    self.host_shown(&switch, *shown);
                }
                response
            }
            Request::Detach { switch, entity } => rib.detach(now, &switch, &entity),
            _ => Refusal::new(RefusalCode::Malformed, "not a request to a RIB").into(),
        })
    }

    /// The RIB does not hold what this switch thinks it holds: the switch reports again, or the
    /// endpoint attaches again.
    fn told_to_detach(&mut self, entity: Name) -> Next {
        if entity == self.name() {
            self.report = Report::Due;
            return Next::Report;
        }
        Next::Reattach(self.links_of_endpoint(&entity), Request::Detach { switch: self.name(), entity })
    }

    /// Refuses what a RIB of this run says if another has taken its place.
    pub(super) fn check_fence(&mut self, run: u64) -> Result<(), Refusal> {
        let now = self.now().clock;
        let Err(fenced) = self.fence.admit(run, now) else { return Ok(()) };
        tracing::warn!(%fenced, "refused what a RIB says");
        if fenced.is_doubtful {
            self.report = Report::Due;
        }
        Err(Refusal::new(RefusalCode::Fenced, fenced.to_string()))
    }

    /// What is to be reported, and over which link; none if it is not due, or there is no way.
    pub(super) fn report_to_send(&mut self) -> Option<Reporting> {
        let (by, run) = self.topology.rib()?;
        if self.report == (Report::Taken { by, run }) {
            return None;
        }
        let link = self.link_toward(&by).ok()?;
        self.report = Report::Sent;
        let attached = self.attached.iter().copied().collect();
        let shown = self.shown().map(Box::new);
        let (switch, own_bit) = (self.identity.proof(), self.routes.own_bit());
        let report = Request::Report { switch, attached, own_bit, shown };
        Some(Reporting { by, run, follows: self.fence.follows(), link, request: onward(by, report) })
    }

    /// This run of the RIB has taken a report that was sent when `follows` was followed. Whether
    /// there is nothing new to report since.
    pub(super) fn report_taken(&mut self, taken: Report, run: u64, follows: Option<u64>) -> bool {
        self.fence.reported(run, follows);
        let is_last = self.report == Report::Sent;
        if is_last {
            self.report = taken;
        }
        is_last
    }

    /// Whether a way to the RIB is now known that was not, or another RIB: then there is something
    /// to report to it.
    pub(super) fn follow_rib(&mut self) -> bool {
        if self.rib.is_some() {
            return false;
        }
        match (self.topology.rib(), self.report) {
            // The RIB may forget a switch that it does not reach either.
            (None, _) => {
                self.report = Report::Due;
                false
            }
            (Some((rib, now)), Report::Taken { by, run }) => (by, run) != (rib, now),
            (Some(_), Report::Due | Report::Sent) => true,
        }
    }
}

/// What an entity asks, if that is what a switch passes on.
pub(super) fn relayed(request: &Request) -> Option<&EntityRequest> {
    match request {
        Request::Onward { request, .. } => match &**request {
            Request::Relay { request, .. } => Some(request),
            _ => None,
        },
        _ => None,
    }
}

/// As it goes on the first link.
pub(super) fn onward(to: Name, request: Request) -> Request {
    Request::Onward { to, hops: MAX_HOPS, request: Box::new(request) }
}
