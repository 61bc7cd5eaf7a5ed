//! The calls of remote clients that a local service is executing, so that a client can cancel one.

use std::collections::HashMap;

use gdp::MessageId;
use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::oneshot;

/// A client and its request.
type Key = (Name, MessageId);

/// The calls that can be cancelled. Their number is that of the pending answers, which is bounded.
#[derive(Default)]
pub struct RunningCalls(Mutex<HashMap<Key, oneshot::Sender<()>>>);

/// A call that can be cancelled until this is dropped.
pub struct Cancellable<'a> {
    running: &'a RunningCalls,
    key: Key,
    cancelled: oneshot::Receiver<()>,
}

impl RunningCalls {
    pub fn begin(&self, client: Name, id: MessageId) -> Cancellable<'_> {
        let (sender, cancelled) = oneshot::channel();
        self.0.lock().insert((client, id), sender);
        Cancellable { running: self, key: (client, id), cancelled }
    }

    /// Cancels a call of this client. Ignores a call that has ended or has not arrived.
    pub fn cancel(&self, client: Name, id: MessageId) {
        if let Some(sender) = self.0.lock().remove(&(client, id)) {
            _ = sender.send(());
        }
    }
}

impl Cancellable<'_> {
    /// Waits until the client cancels the call. Waits forever if it does not.
    pub async fn cancelled(&mut self) {
        if (&mut self.cancelled).await.is_err() {
            std::future::pending().await
        }
    }
}

impl Drop for Cancellable<'_> {
    fn drop(&mut self) {
        self.running.0.lock().remove(&self.key);
    }
}

#[cfg(test)]
#[path = "../../tests/unit/call/running.rs"]
mod tests;
