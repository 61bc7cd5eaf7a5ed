//! This switch's report to the RIB: its presence, and the endpoints attached to it.

use gdp_proto::control::Request;

use super::Core;
use super::follow_up::FollowUp;
use super::relay::onward;
use super::rib_client::{PendingReport, Report};

impl Core {
    /// Returns the report to send and its link. Returns `None` if no report is due, or there is no
    /// path to the RIB.
    pub fn report_to_send(&mut self) -> Option<PendingReport> {
        let (by, run) = self.topology.rib()?;
        if self.rib_client.report == (Report::Accepted { by, run }) {
            return None;
        }
        let link = self.link_toward(&by).ok()?;
        self.rib_client.report = Report::Sent;
        let attached = self.switch.attached.iter().copied().collect();
        let membership = self.membership.statement(&self.identity).map(Box::new);
        let (switch, own_bit) = (self.identity.proof(), self.switch.routes.own_bit());
        let report = Request::Report { switch, attached, own_bit, membership };
        let follows = self.rib_client.fence.follows();
        Some(PendingReport { by, run, follows, link, request: onward(by, report) })
    }

    /// Reports this switch to the local RIB.
    pub fn report_here(&mut self) -> FollowUp {
        let attached: Vec<_> = self.switch.attached.iter().copied().collect();
        let (proof, own_bit) = (self.identity.proof(), self.switch.routes.own_bit());
        self.rib_client.report = Report::Sent;
        self.rib_host.report(self.clock.now(), None, &proof, (&attached, own_bit), None)
    }
}
