//! The latest events of the switch. A thread follows `monitor` for as long as the program runs.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use gdp_proto::admin::event::TimedEvent;
use parking_lot::Mutex;

use super::snapshot::{EventLine, text};
use crate::cli::context::Context;
use crate::cli::monitor;

/// How many events are stored.
const MOST: usize = 100;

/// Time between attempts to reach the daemon.
const PAUSE: Duration = Duration::from_secs(2);

#[derive(Default)]
pub struct RecentEvents(Mutex<VecDeque<EventLine>>);

impl RecentEvents {
    /// Follows the daemon's events from now on, also those of its successors.
    pub fn follow(context: Context) -> Arc<Self> {
        let events = Arc::new(Self::default());
        let followed = events.clone();
        std::thread::spawn(move || {
            loop {
                let stream = context.client().and_then(|client| Ok(client.monitor()?));
                for event in stream.into_iter().flatten().map_while(Result::ok) {
                    followed.add(&event);
                }
                std::thread::sleep(PAUSE);
            }
        });
        events
    }

    pub fn add(&self, TimedEvent { at, event }: &TimedEvent) {
        let (kind, what) = monitor::words(event);
        let mut events = self.0.lock();
        events.push_front(EventLine { at_ms: at / 1_000_000, kind, what: text(&what) });
        events.truncate(MOST);
    }

    /// Returns the events, the latest first.
    pub fn latest(&self) -> Vec<EventLine> {
        self.0.lock().iter().cloned().collect()
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/web/events.rs"]
mod tests;
