//! The copies of a call that goes to several servers at once. Servers whose answer is no longer
//! needed are notified.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use futures::future::join_all;
use gdp::MessageId;
use gdp::unstable::Client;
use gdp_ros::call::{CALL, Request};
use gdp_wire::Name;
use parking_lot::Mutex;

/// Timeout of the notifications of one call. A lost one costs the server's proxy a pending call.
const NOTIFY: Duration = Duration::from_millis(200);

/// The copies of one call.
#[derive(Default)]
pub struct Copies {
    /// The sent copies that wait for a reply, one for each server. `None` if the request is not
    /// replicated.
    waiting: Mutex<Option<Vec<(Name, MessageId)>>>,
    is_won_by_other: AtomicBool,
}

impl Copies {
    /// Begins to record the copies of a replicated request.
    pub fn record(&self) {
        *self.waiting.lock() = Some(Vec::new());
    }

    pub fn begin(&self, server: Name, id: MessageId) {
        if let Some(waiting) = &mut *self.waiting.lock() {
            waiting.push((server, id));
        }
    }

    pub fn end(&self, server: Name) {
        if let Some(waiting) = &mut *self.waiting.lock() {
            waiting.retain(|(waiting, _)| *waiting != server);
        }
    }

    /// Records the first answer. Servers are numbered from the nearest, with 0.
    pub fn win(&self, server: usize) {
        self.is_won_by_other.store(server > 0, Relaxed);
    }

    /// Whether another server than the nearest has answered first.
    pub fn is_won_by_other(&self) -> bool {
        self.is_won_by_other.load(Relaxed)
    }

    /// Notifies the servers that still execute a copy, as far as they can be reached at once.
    /// Returns their number.
    pub async fn cancel(&self, client: &Client) -> usize {
        let waiting = self.waiting.lock().take().unwrap_or_default();
        let cancel = |(server, id): &(Name, MessageId)| {
            let (server, request) = (*server, Request::Cancel(*id).to_bytes());
            async move { client.notify_at(server, CALL, &request).await }
        };
        _ = tokio::time::timeout(NOTIFY, join_all(waiting.iter().map(cancel))).await;
        waiting.len()
    }
}

#[cfg(test)]
#[path = "../../tests/unit/call/copies.rs"]
mod tests;
