//! Answers questions of attached endpoints: their own attachment, and the paths of names to which
//! they may send.
//!
//! An endpoint learns nothing of other endpoints, except how many links a switch has to receivers
//! of such a name. Of an unknown name and of one to which it may not send, it gets the same answer.

use std::sync::Arc;

use gdp_core::peer::Role;
use gdp_link::link::Link;
use gdp_proto::control::{
    AttachmentStatus, Inspected, Inspection, MAX_STATED_LINKS, MAX_STATED_NAMES, NameLocation, OwnLink, ProbeEnd,
    Refusal, RefusalCode, Response,
};
use gdp_wire::Name;

use super::core::Core;
use super::core::link_state::LinkState;
use super::core::probes::ProbeError;
use super::daemon::Daemon;
use super::status;
use super::trace::Hop;
use crate::config::Inside;
use crate::domain::Relationship;

/// Answers a question of the endpoint at the other end of the link.
pub async fn answer(daemon: &Arc<Daemon>, link: &Link, inspection: Inspection) -> Response {
    match inspect(daemon, link, inspection).await {
        Ok(inspected) => Response::Inspected(inspected),
        Err(refusal) => refusal.into(),
    }
}

async fn inspect(daemon: &Arc<Daemon>, link: &Link, inspection: Inspection) -> Result<Inspected, Refusal> {
    {
        let mut core = daemon.core();
        let now = core.now().clock;
        let state = core.switch.links.get_mut(&link.local_id());
        if !state.is_some_and(|state| state.inspections.take(now)) {
            return Err(Refusal::new(RefusalCode::Limit, "too many questions to this switch; try again in a second"));
        }
        let is_attached = link.peer().role != Role::Endpoint || core.switch.attached.contains(&link.peer().name);
        if matches!(inspection, Inspection::Status) && !is_attached {
            return Err(Refusal::new(RefusalCode::NotEntitled, "the endpoint is not attached to this switch yet"));
        }
    }
    match inspection {
        Inspection::Status => Ok(Inspected::Status(Box::new(attachment(daemon, link.peer().name)))),
        Inspection::Locate { name } => daemon.core().location_for(link, name).map(Inspected::Location),
        Inspection::Probe { name, egress, hops } => {
            let location = daemon.core().location_for(link, name)?;
            if !location.egress.contains(&egress) {
                return Err(not_for(name));
            }
            if egress == daemon.core().name() {
                return Ok(Inspected::Probe(ProbeEnd { switch: Some(egress), links: Some(location.links) }));
            }
            // The quota of the endpoint, as a neighbouring domain has its own.
            let probed = daemon.probe(Some(link.peer().name), name, egress, hops).await;
            let hop = probed.map_err(|error| Refusal::new(code(&error), error.to_string()))?;
            let end =
                hop.map(|Hop { switch, end, .. }| ProbeEnd { switch: Some(switch), links: end.map(|end| end.links) });
            Ok(Inspected::Probe(end.unwrap_or_default()))
        }
    }
}

fn code(error: &ProbeError) -> RefusalCode {
    match error {
        ProbeError::Busy(_) => RefusalCode::Limit,
        ProbeError::NoPath(_) | ProbeError::NoLink(_) | ProbeError::Random(_) => RefusalCode::Unreachable,
        ProbeError::Unknown(_) | ProbeError::Ambiguous(_) | ProbeError::NoWay(_) => RefusalCode::NotFound,
    }
}

fn not_for(name: Name) -> Refusal {
    let reason = format!(
        "this endpoint may not send to {name:#} here, so this switch does not say where it is; a publisher may ask \
         about its name, and a reader about its publishers"
    );
    Refusal::new(RefusalCode::NotFound, reason)
}

impl Core {
    /// Returns the egress switches of a name to which the endpoint may send, or of this switch.
    fn location_for(&self, link: &Link, name: Name) -> Result<NameLocation, Refusal> {
        if name == self.name() {
            return Ok(NameLocation { egress: vec![name], links: 0 });
        }
        let id = link.local_id();
        let peer = link.peer().name;
        let writers = self.switch.planes.writers(&name);
        if !self.switch.links_of(&peer).chain([id]).any(|id| writers.contains(&id)) {
            return Err(not_for(name));
        }
        let relationship = self.switch.links.get(&id).map(|state| &state.admission.relationship);
        if matches!(relationship, Some(Relationship::Visitor { .. }))
            && self.membership.trace_visibility == Inside::Masked
        {
            let reason = "this domain does not show its switches to endpoints of others; its operator may set \
                          `trace: open` under `domain`";
            return Err(Refusal::new(RefusalCode::NotEntitled, reason));
        }
        Ok(NameLocation { egress: self.egress_of(&name).collect(), links: self.switch.end_of(&name).links })
    }
}

/// Returns this switch's status for an endpoint.
fn attachment(daemon: &Daemon, endpoint: Name) -> AttachmentStatus {
    let core = daemon.core();
    let links = core.switch.links_of(&endpoint).filter_map(|id| core.switch.links.get(&id));
    let (names, truncated) = core.switch.routes.names_of(&endpoint, MAX_STATED_NAMES);
    AttachmentStatus {
        switch: core.name(),
        release: env!("CARGO_PKG_VERSION").into(),
        domain: core.membership.home(),
        data_plane: status::data_plane(&core).0.into(),
        no_rib: core.rib_at().err().filter(|_| core.rib_host.rib.is_none()).map(|refusal| refusal.reason),
        links: links.take(MAX_STATED_LINKS).map(|state| own_link(daemon, state)).collect(),
        names,
        truncated,
    }
}

fn own_link(daemon: &Daemon, state: &LinkState) -> OwnLink {
    let link = &state.link;
    OwnLink {
        lane: link.peer().lane,
        address: daemon.peer_address(link),
        mtu: link.mtu(),
        rtt_us: link.rtt().as_micros() as u64,
        age_s: state.since.elapsed().as_secs(),
        admitted_until: (state.admission.until < u64::MAX).then_some(state.admission.until),
    }
}
