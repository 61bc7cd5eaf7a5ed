//! Damping of links that fail again and again, after route flap damping (RFC 2439): each failure
//! adds a penalty, which decays exponentially. Above one threshold the link is suppressed, until
//! the penalty is below a lower one.

use std::time::Duration;

/// Penalty of one failure.
const FAILURE: f64 = 1.0;

/// Time in which the penalty halves.
const HALF_LIFE: Duration = Duration::from_secs(10);

/// The third failure within about a half-life suppresses the link. A cable that is plugged in again
/// often fails twice.
const SUPPRESS: f64 = 2.2;
const REUSE: f64 = 1.0;

/// Longest suppression after the last failure.
const LONGEST: Duration = Duration::from_secs(60);

/// The failures of the link to one neighbour.
#[derive(Clone, Debug, Default)]
pub struct Damper {
    penalty: f64,
    /// Time of the last failure.
    at: Duration,
    suppressed: bool,
}

impl Damper {
    /// Records a failure.
    pub fn failed(&mut self, now: Duration) {
        let highest = REUSE * (LONGEST.as_secs_f64() / HALF_LIFE.as_secs_f64()).exp2();
        self.penalty = (self.penalty_at(now) + FAILURE).min(highest);
        self.at = now;
        self.suppressed |= self.penalty >= SUPPRESS;
    }

    /// Returns whether the link should be avoided although it works.
    pub fn is_suppressed(&self) -> bool {
        self.suppressed
    }

    /// Ends the suppression if it is over. Returns whether it has ended now.
    pub fn follow(&mut self, now: Duration) -> bool {
        let ends = self.suppressed && self.penalty_at(now) <= REUSE;
        self.suppressed &= !ends;
        ends
    }

    /// Returns whether the failures are so long ago that they no longer matter.
    pub fn is_clear(&self, now: Duration) -> bool {
        !self.suppressed && self.penalty_at(now) < REUSE / 16.0
    }

    fn penalty_at(&self, now: Duration) -> f64 {
        let half_lives = now.saturating_sub(self.at).as_secs_f64() / HALF_LIFE.as_secs_f64();
        self.penalty * (-half_lives).exp2()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/topology/damping.rs"]
mod tests;
