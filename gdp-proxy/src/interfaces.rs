//! Changes of this machine's network interfaces, which DDS has to follow: a robot's proxy starts
//! before its cables and radios are up.

use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;

/// Time for which notifications are gathered, because one change causes several.
const GATHER: Duration = Duration::from_millis(300);

pub struct Interfaces {
    changes: watch::Receiver<()>,
    due: Option<Instant>,
}

impl Interfaces {
    /// `changes` is notified of every change.
    pub fn new(changes: watch::Receiver<()>) -> Self {
        Self { changes, due: None }
    }

    /// Waits until interfaces have changed. Safe to cancel.
    pub async fn changed(&mut self) {
        loop {
            tokio::select! {
                changed = self.changes.changed() => match changed {
                    Ok(()) => _ = self.due.get_or_insert_with(|| Instant::now() + GATHER),
                    // The node has ended.
                    Err(_) => std::future::pending().await,
                },
                () = tokio::time::sleep_until(self.due.unwrap_or_else(Instant::now)), if self.due.is_some() => {
                    self.due = None;
                    return;
                }
            }
        }
    }
}
