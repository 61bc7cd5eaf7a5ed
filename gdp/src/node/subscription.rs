//! The application's receiving end of a name.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use gdp_wire::Name;
use tokio::sync::mpsc;

use super::{Handle, Stated};
use crate::seal::{Limits, Message};

/// How much a subscription may hold, and what it refuses.
#[derive(Clone, Copy, Debug)]
pub struct SubscribeOptions {
    /// For messages that are not complete yet, and for how old they may be.
    pub limits: Limits,
    /// Complete messages that wait for [`Subscription::recv`]; more are dropped and counted.
    pub queue: usize,
    /// Bytes of their bodies.
    pub queue_bytes: usize,
}

impl Default for SubscribeOptions {
    fn default() -> Self {
        Self { limits: Limits::default(), queue: 256, queue_bytes: 64 << 20 }
    }
}

/// Receives the verified messages of a name. Dropping it ends the subscription.
pub struct Subscription {
    node: Arc<Handle>,
    name: Name,
    queue: mpsc::Receiver<Message>,
    queued_bytes: Arc<AtomicUsize>,
}

impl Subscription {
    pub(super) fn new(
        node: Arc<Handle>,
        name: Name,
        queue: mpsc::Receiver<Message>,
        queued_bytes: Arc<AtomicUsize>,
    ) -> Self {
        Self { node, name, queue, queued_bytes }
    }

    pub fn name(&self) -> Name {
        self.name
    }

    /// The next message; `None` once the node is closed. Safe to cancel.
    pub async fn recv(&mut self) -> Option<Message> {
        let message = self.queue.recv().await?;
        self.queued_bytes.fetch_sub(message.body.len(), Ordering::Relaxed);
        Some(message)
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.node.state.withdraw(self.name, Stated::Subscribed);
    }
}
