//! What happens at a switch, told to whoever listens (`gdp-ctl monitor`). Nobody waits for a
//! listener: one that is too slow misses the oldest events, and is told how many.

use gdp_wire::Name;
use serde::Serialize;
use serde_json::{Value, json};
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

use gdp_util::unix_time::unix_nanos;

/// Events that wait for a listener.
const MAX_WAITING: usize = 1024;

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    LinkUp {
        peer: Name,
        role: &'static str,
        standing: &'static str,
        via: String,
        address: String,
    },
    LinkDown {
        peer: Name,
        reason: String,
    },
    /// A peer, or this side, does not want the link; or nobody answers.
    LinkRefused {
        peer: Name,
        via: String,
        reason: String,
    },
    Attached {
        entity: Name,
    },
    Detached {
        entity: Name,
    },
    /// The RIB has changed what this switch forwards by: so many routes.
    Routes {
        generation: u64,
        changes: usize,
    },
    /// There are other paths; `reached`: switches with a path from here, this one among them.
    Topology {
        switches: usize,
        reached: usize,
    },
    /// The RIB here knows so many names and switches now.
    Rib {
        names: usize,
        switches: usize,
    },
    /// The listener was too slow for so many events.
    Missed {
        events: u64,
    },
}

/// Tells events to all listeners.
#[derive(Clone)]
pub struct Events(broadcast::Sender<(u64, Event)>);

/// A listener.
pub struct Listener(broadcast::Receiver<(u64, Event)>);

impl Default for Events {
    fn default() -> Self {
        Self(broadcast::channel(MAX_WAITING).0)
    }
}

impl Events {
    pub fn tell(&self, event: Event) {
        if self.0.receiver_count() > 0 {
            // The last listener may just have gone.
            let _ = self.0.send((unix_nanos(), event));
        }
    }

    /// Of what happens from now on.
    pub fn listen(&self) -> Listener {
        Listener(self.0.subscribe())
    }
}

impl Listener {
    /// The next event as JSON, with `at`, the Unix time in nanoseconds; `None` once nobody tells
    /// any more.
    pub async fn next(&mut self) -> Option<Value> {
        let (at, event) = match self.0.recv().await {
            Ok(told) => told,
            Err(RecvError::Lagged(events)) => (unix_nanos(), Event::Missed { events }),
            Err(RecvError::Closed) => return None,
        };
        let mut value = serde_json::to_value(event).unwrap_or_else(|error| json!({"event": error.to_string()}));
        value["at"] = at.into();
        Some(value)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/events.rs"]
mod tests;
