//! The events at a switch, sent to listeners (`gdp-ctl monitor`). A slow listener does not block
//! the switch. It misses the oldest events, and learns how many.

pub use gdp_proto::admin::event::Event;

use gdp_proto::admin::event::TimedEvent;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

use gdp_util::unix_time::unix_nanos;

/// The maximum number of events that wait for a listener.
const MAX_WAITING: usize = 1024;

/// Tells events to all listeners.
#[derive(Clone)]
pub struct Events(broadcast::Sender<TimedEvent>);

/// A listener.
pub struct Listener(broadcast::Receiver<TimedEvent>);

impl Default for Events {
    fn default() -> Self {
        Self(broadcast::channel(MAX_WAITING).0)
    }
}

impl Events {
    pub fn tell(&self, event: Event) {
        if self.0.receiver_count() > 0 {
            // The last listener may just have gone.
            let _ = self.0.send(TimedEvent { at: unix_nanos(), event });
        }
    }

    /// Returns a listener for future events.
    pub fn listen(&self) -> Listener {
        Listener(self.0.subscribe())
    }
}

impl Listener {
    /// The next event; `None` once nobody sends any more.
    pub async fn next(&mut self) -> Option<TimedEvent> {
        match self.0.recv().await {
            Ok(event) => Some(event),
            Err(RecvError::Lagged(events)) => Some(TimedEvent { at: unix_nanos(), event: Event::Missed { events } }),
            Err(RecvError::Closed) => None,
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/events.rs"]
mod tests;
