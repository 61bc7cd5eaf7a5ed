//! The queue of verified messages between the receiving thread and a handle.

use std::future::poll_fn;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::task::{Context, Poll, ready};

use gdp_wire::Name;
use tokio::sync::mpsc;

use super::command::{Command, Commands};
use super::queue_state::QueueState;
use gdp_e2e::seal::Message;

/// The queue of verified messages from the receiving thread.
pub struct Queue {
    pub name: Name,
    pub shared: Arc<QueueState>,
    commands: Commands,
    receiver: mpsc::Receiver<Message>,
}

impl Queue {
    pub fn new(name: Name, receiver: mpsc::Receiver<Message>, shared: Arc<QueueState>, commands: Commands) -> Self {
        Self { name, shared, commands, receiver }
    }

    /// Returns the next message, or `None` at the end. Safe to cancel.
    pub async fn recv(&mut self) -> Option<Message> {
        poll_fn(|context| self.poll_recv(context)).await
    }

    /// Polls for the next message.
    pub fn poll_recv(&mut self, context: &mut Context<'_>) -> Poll<Option<Message>> {
        let Self { receiver, shared, .. } = self;
        let Some(message) = ready!(shared.direct.poll_next(receiver, context)) else { return Poll::Ready(None) };
        self.shared.queued_bytes.fetch_sub(message.body.len(), Ordering::Relaxed);
        if self.shared.stalled.load(Ordering::Relaxed) && self.receiver.len() <= self.receiver.max_capacity() / 2 {
            self.commands.send(Command::Resume { name: self.name });
        }
        Poll::Ready(Some(message))
    }
}
