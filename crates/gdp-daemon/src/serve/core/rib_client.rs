//! This switch as a client of the RIB: the RIB run it follows, the state of its report, and the
//! peerings that the RIB wants.

use std::time::Duration;

use gdp_core::cert::MAX_ADDRESSES;
use gdp_link::link::Link;
use gdp_proto::control::{Refusal, RefusalCode, Request};
use gdp_rib::leadership::fence::Fence;
use gdp_rib::tiers::peering::WantedPeerings;
use gdp_wire::Name;
use tokio::sync::watch;

/// The state of this switch's report to the RIB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Report {
    #[default]
    Due,
    /// The report is sent and not answered. Nothing has changed since.
    Sent,
    /// The RIB at switch `by` has accepted the report, in this run of its daemon.
    Accepted { by: Name, run: u64 },
}

/// A report to send to the RIB at switch `by`, in this run of its daemon.
pub struct PendingReport {
    pub by: Name,
    pub run: u64,
    /// The RIB run that the switch followed when it made the report.
    pub follows: Option<u64>,
    pub link: Link,
    pub request: Request,
}

/// What this switch knows of its RIB.
#[derive(Default)]
pub struct RibClient {
    pub report: Report,
    /// Selects the RIB run to follow when several claim to be the RIB.
    pub fence: Fence,
    /// The links into other domains that the RIB wants this switch to have.
    pub peerings: watch::Sender<WantedPeerings>,
}

impl RibClient {
    /// Refuses a message of this RIB run if another RIB has taken its place. `now` is the time of
    /// the daemon's clock.
    pub fn check_fence(&mut self, now: Duration, run: u64) -> Result<(), Refusal> {
        let Err(fenced) = self.fence.admit(run, now) else { return Ok(()) };
        tracing::warn!(%fenced, "refused what a RIB says");
        if fenced.is_doubtful {
            self.report = Report::Due;
        }
        Err(Refusal::new(RefusalCode::Fenced, fenced.to_string()))
    }

    /// Stores the links into other domains that the RIB of this run wants this switch to have.
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

    /// Records that this run of the RIB accepted a report. `follows` is the run that the switch
    /// followed when it sent the report. Returns whether nothing has changed since.
    pub fn report_accepted(&mut self, accepted: Report, run: u64, follows: Option<u64>) -> bool {
        self.fence.reported(run, follows);
        let is_last = self.report == Report::Sent;
        if is_last {
            self.report = accepted;
        }
        is_last
    }

    /// Follows the RIB's location in the topology: its switch and its run. Returns whether a report
    /// is due, because the RIB there has not accepted one. Without a RIB, schedules a report for
    /// later.
    pub fn follow(&mut self, rib: Option<(Name, u64)>) -> bool {
        match (rib, self.report) {
            // The RIB may drop a switch that it does not reach either.
            (None, _) => {
                self.report = Report::Due;
                false
            }
            (Some((rib, now)), Report::Accepted { by, run }) => (by, run) != (rib, now),
            (Some(_), Report::Due | Report::Sent) => true,
        }
    }
}
