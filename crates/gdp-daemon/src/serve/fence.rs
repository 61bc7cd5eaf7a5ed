//! Which run of the RIB this switch follows. A later leader of several replicas has a higher one
//! (of its [term](super::term)), as has a RIB that started later, so what somebody says whose time
//! is over is refused from the moment on that a later one has said anything. Sans-IO.
//!
//! Runs may begin anew below: a clock went back, etcd was set up anew, or a RIB that ran alone
//! became several replicas. So that a switch is not stuck with a number that nobody reaches, it
//! follows whichever RIB takes its report: that is where the topology says that the RIB is now, and
//! a replica says so only after etcd has said that it leads. Should both claim to be there, it asks
//! again.

use std::time::Duration;

/// Between two reports that nothing but a refusal is the reason for.
const ASK_AGAIN: Duration = Duration::from_secs(30);

/// What a RIB said that is not the one that is followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this switch follows run {follows:#x} of the RIB; the term of run {run:#x} is over")]
pub struct Fenced {
    pub follows: u64,
    pub run: u64,
    /// The switch is to report again, to find out who is the RIB: it was this one when it last did,
    /// or it was told something false.
    pub is_doubtful: bool,
}

#[derive(Debug, Default)]
pub struct Fence {
    follows: Option<u64>,
    /// The run that has taken this switch's last report.
    reported: Option<u64>,
    /// When a refusal was last a reason to report.
    asked: Option<Duration>,
    refused: u64,
}

impl Fence {
    /// The run that is followed, once there is one.
    pub fn follows(&self) -> Option<u64> {
        self.follows
    }

    /// How often something was refused.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Whether what a RIB of this run says is to be taken. `now`: on a clock that does not go back.
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

    /// The RIB of this run has taken a report that was sent when `then` was followed. If another
    /// has said something since, that may be the later one.
    pub fn reported(&mut self, run: u64, then: Option<u64>) {
        self.reported = Some(run);
        if self.follows == then || self.follows < Some(run) {
            self.follows = Some(run);
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/fence.rs"]
mod tests;
