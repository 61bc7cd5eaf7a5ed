//! This switch as a client of the RIB, wherever that is: which run of the RIB it follows, whether
//! that has its report, and which peerings the RIB wants of it.

use std::time::Duration;

use gdp_core::cert::MAX_ADDRESSES;
use gdp_link::link::Link;
use gdp_proto::control::{Refusal, RefusalCode, Request};
use gdp_rib::tiers::peering::WantedPeerings;
use gdp_wire::Name;
use tokio::sync::watch;

use crate::serve::fence::Fence;

/// How far the RIB has what this switch is to report: that it is there, and who is attached to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Report {
    #[default]
    Due,
    /// Sent, and not answered; nothing has changed since.
    Sent,
    /// Accepted by the RIB at switch `by`, in this run of its daemon.
    Accepted { by: Name, run: u64 },
}

/// A report that is to be sent to the RIB at the switch `by`, in this run of its daemon.
pub struct PendingReport {
    pub by: Name,
    pub run: u64,
    /// The run of the RIB that was followed then.
    pub follows: Option<u64>,
    pub link: Link,
    pub request: Request,
}

/// What this switch knows of its RIB.
#[derive(Default)]
pub struct RibClient {
    pub report: Report,
    /// Of several that say they are the RIB, which one is followed.
    pub fence: Fence,
    /// The links into other domains that the RIB wants this switch to have.
    pub peerings: watch::Sender<WantedPeerings>,
}

impl RibClient {
    /// Refuses what a RIB of this run says if another has taken its place. `now`: on the daemon's
    /// clock.
    pub fn check_fence(&mut self, now: Duration, run: u64) -> Result<(), Refusal> {
        let Err(fenced) = self.fence.admit(run, now) else { return Ok(()) };
        tracing::warn!(%fenced, "refused what a RIB says");
        if fenced.is_doubtful {
            self.report = Report::Due;
        }
        Err(Refusal::new(RefusalCode::Fenced, fenced.to_string()))
    }

    /// The RIB of this run wants this switch to have these links into other domains.
    pub fn set_peerings(&mut self, now: Duration, run: u64, mut wanted: WantedPeerings) -> Result<(), Refusal> {
        self.check_fence(now, run)?;
        wanted.values_mut().for_each(|addrs| addrs.truncate(MAX_ADDRESSES));
        self.peerings.send_if_modified(|before| {
            let changed = *before != wanted;
            *before = wanted;
            changed
        });
        Ok(())
    }

    /// This run of the RIB has accepted a report that was sent when `follows` was followed. Whether
    /// there is nothing new to report since.
    pub fn report_accepted(&mut self, accepted: Report, run: u64, follows: Option<u64>) -> bool {
        self.fence.reported(run, follows);
        let is_last = self.report == Report::Sent;
        if is_last {
            self.report = accepted;
        }
        is_last
    }

    /// Follows the topology, in which the RIB is at this switch, in this run of its daemon. Whether
    /// there is something to report to it: it can be reached again, or is another one.
    pub fn follow(&mut self, rib: Option<(Name, u64)>) -> bool {
        match (rib, self.report) {
            // The RIB may forget a switch that it does not reach either.
            (None, _) => {
                self.report = Report::Due;
                false
            }
            (Some((rib, now)), Report::Accepted { by, run }) => (by, run) != (rib, now),
            (Some(_), Report::Due | Report::Sent) => true,
        }
    }
}
