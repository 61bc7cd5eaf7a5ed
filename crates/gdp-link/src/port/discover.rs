//! "Which switch is on this segment?" Solicitations and answers are hints in clear: what an answer
//! claims, TLS proves when the link is made. Answers are rate-limited, so that a switch is no
//! amplifier and no target of spoofed questions.

use std::time::{Duration, Instant};

use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::broadcast;

/// Answers a switch gives per interface and interval.
const ANSWERS: u32 = 32;
const INTERVAL: Duration = Duration::from_secs(1);

/// Answers that wait for a slow asker; more are lost.
const BACKLOG: usize = 64;

/// One interface's side of discovery, asking and answering. No I/O.
pub struct Discovery {
    answer_as: Option<Name>,
    budget: Mutex<(Instant, u32)>,
    answers: broadcast::Sender<([u8; 6], Name)>,
}

impl Discovery {
    pub fn new(answer_as: Option<Name>) -> Self {
        Self { answer_as, budget: Mutex::new((Instant::now(), ANSWERS)), answers: broadcast::channel(BACKLOG).0 }
    }

    /// What to answer a solicitation with, if it is to be answered.
    pub fn answer(&self) -> Option<Name> {
        let name = self.answer_as?;
        let mut budget = self.budget.lock();
        if budget.0.elapsed() >= INTERVAL {
            *budget = (Instant::now(), ANSWERS);
        }
        budget.1 = budget.1.checked_sub(1)?;
        Some(name)
    }

    /// An answer arrived; it goes to whoever asks at the moment.
    pub fn answered(&self, from: [u8; 6], name: Name) {
        let _ = self.answers.send((from, name));
    }

    pub fn listen(&self) -> broadcast::Receiver<([u8; 6], Name)> {
        self.answers.subscribe()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/port/discover.rs"]
mod tests;
