//! Discovery of switches on a segment.
//!
//! Solicitations and answers are plaintext hints: TLS proves the claim of an answer when a link is
//! made. Rate limits on answers prevent the use of a switch as an amplifier, and limit its load
//! from spoofed solicitations.

use std::time::{Duration, Instant};

use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::broadcast;

/// Maximum number of answers of a switch per interface and interval.
const ANSWERS: u32 = 32;
const INTERVAL: Duration = Duration::from_secs(1);

/// Queue length of answers for a slow requester. Further answers are lost.
const BACKLOG: usize = 64;

/// The discovery state of one interface, for both roles. No I/O.
pub struct Discovery {
    answer_as: Option<Name>,
    budget: Mutex<(Instant, u32)>,
    answers: broadcast::Sender<([u8; 6], Name)>,
}

impl Discovery {
    pub fn new(answer_as: Option<Name>) -> Self {
        Self { answer_as, budget: Mutex::new((Instant::now(), ANSWERS)), answers: broadcast::channel(BACKLOG).0 }
    }

    /// Returns the name to answer a solicitation with, or `None` if the port does not answer.
    pub fn answer(&self) -> Option<Name> {
        let name = self.answer_as?;
        let mut budget = self.budget.lock();
        if budget.0.elapsed() >= INTERVAL {
            *budget = (Instant::now(), ANSWERS);
        }
        budget.1 = budget.1.checked_sub(1)?;
        Some(name)
    }

    /// Delivers an answer to the current requesters.
    pub fn answered(&self, from: [u8; 6], name: Name) {
        let _ = self.answers.send((from, name));
    }

    pub fn listen(&self) -> broadcast::Receiver<([u8; 6], Name)> {
        self.answers.subscribe()
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/port/linux/discover.rs"]
mod tests;
