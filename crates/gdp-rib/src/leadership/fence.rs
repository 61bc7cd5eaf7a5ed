//! Selects the RIB run that this switch follows. Sans-IO.
//!
//! A later leader of several replicas has a higher run, made from its term. A RIB that started
//! later has a higher run too. The switch refuses messages of lower runs from the first message of
//! a higher one.
//!
//! Runs may start again at a lower number: a clock went back, etcd was set up anew, or a single RIB
//! became several replicas. A switch must not wait for a number that no RIB reaches. It therefore
//! follows whichever RIB accepts its report, at the location in the topology. A replica claims this
//! location only after etcd has confirmed that it leads. If two RIBs claim it, the switch reports
//! again.

use std::time::Duration;

/// The minimum time between two reports that only a refusal caused.
const ASK_AGAIN: Duration = Duration::from_secs(30);

/// The refusal of a message of a RIB that this switch does not follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this switch follows run {follows:#x} of the RIB; the term of run {run:#x} is over")]
pub struct Fenced {
    pub follows: u64,
    pub run: u64,
    /// Whether the switch must report again to find the current RIB. Either this run accepted its
    /// last report, or no refusal caused a report recently.
    pub is_doubtful: bool,
}

/// The RIB runs of which this switch accepts messages.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Fence {
    follows: Option<u64>,
    /// The run that accepted this switch's last report.
    reported: Option<u64>,
    /// The time when a refusal last caused a report.
    asked: Option<Duration>,
    refused: u64,
}

impl Fence {
    /// Returns the run that the switch follows, if there is one.
    pub fn follows(&self) -> Option<u64> {
        self.follows
    }

    /// Returns the number of refused messages.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Checks whether to accept a message of this RIB run. `now` is on a monotonic clock.
    pub fn admit(&mut self, run: u64, now: Duration) -> Result<(), Fenced> {
        match self.follows {
            Some(follows) if run < follows => {
                self.refused += 1;
                let is_long_ago = self.asked.is_none_or(|asked| now >= asked + ASK_AGAIN);
                let is_doubtful = self.reported == Some(run) || is_long_ago;
                self.asked = if is_doubtful { Some(now) } else { self.asked };
                Err(Fenced { follows, run, is_doubtful })
            }
            _ => {
                self.follows = Some(run);
                Ok(())
            }
        }
    }

    /// Records that the RIB of this run accepted a report, sent when the switch followed `then`.
    /// Follows the run unless a higher one has sent a message in the meantime.
    pub fn reported(&mut self, run: u64, then: Option<u64>) {
        self.reported = Some(run);
        if self.follows == then || self.follows < Some(run) {
            self.follows = Some(run);
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/leadership/fence.rs"]
mod tests;
