//! The application's receiving end of a name.

use std::sync::atomic::Ordering;
use std::sync::{Arc, OnceLock};

use gdp_wire::Name;
use tokio::sync::mpsc;

use super::intake::Shared;
use super::receiver::Command;
use super::state::State;
use super::{Handle, Stated};
use crate::cert::CertError;
use crate::seal::Message;
use crate::transport::InboundCounters;

/// Verified messages from the receiving thread.
pub struct Queue {
    pub name: Name,
    receiver: mpsc::Receiver<Message>,
    shared: Arc<Shared>,
}

impl Queue {
    pub fn new(name: Name, receiver: mpsc::Receiver<Message>, shared: Arc<Shared>) -> Self {
        Self { name, receiver, shared }
    }

    /// The next; `None` once there are no more. Safe to cancel.
    pub async fn recv(&mut self, state: &State) -> Option<Message> {
        let message = self.receiver.recv().await?;
        self.shared.queued_bytes.fetch_sub(message.body.len(), Ordering::Relaxed);
        if self.shared.stalled.load(Ordering::Relaxed) && self.receiver.len() <= self.receiver.max_capacity() / 2 {
            state.command(Command::Resume { name: self.name });
        }
        Some(message)
    }
}

/// Receives the verified messages of a name. Dropping it ends the subscription.
pub struct Subscription {
    node: Arc<Handle>,
    queue: Queue,
    ended: Arc<OnceLock<CertError>>,
}

impl Subscription {
    pub(super) fn new(node: Arc<Handle>, queue: Queue, ended: Arc<OnceLock<CertError>>) -> Self {
        Self { node, queue, ended }
    }

    pub fn name(&self) -> Name {
        self.queue.name
    }

    /// The next message; `None` once the node is closed, or the grant holds no more ([`Self::ended`]). Safe to cancel.
    pub async fn recv(&mut self) -> Option<Message> {
        self.queue.recv(&self.node.state).await
    }

    /// Why nothing is received any more, if that is because the grant holds no more.
    pub fn ended(&self) -> Option<&CertError> {
        self.ended.get()
    }

    /// What became of messages and segments so far; of those `delivered`, [`Self::queue_full`] and [`Self::repeats`] did not reach the
    /// application.
    pub fn counters(&self) -> InboundCounters {
        self.queue.shared.counters.get()
    }

    /// Messages that were dropped because the application did not take them in time; none of a reliable name.
    pub fn queue_full(&self) -> u64 {
        self.queue.shared.counters.queue_full.load(Ordering::Relaxed)
    }
}

impl Subscription {
    /// Latched messages that were sent again for others, and are known here.
    pub fn repeats(&self) -> u64 {
        self.queue.shared.counters.repeats.load(Ordering::Relaxed)
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.node.state.withdraw(self.queue.name, Stated::Subscribed);
    }
}
