//! The direct path of messages to the application: the receiving thread passes them to a function,
//! without the queue and its wake-up.
//!
//! No message overtakes an earlier one. The receiving thread uses the sink only while the queue is
//! empty and the application has come back for more, so that it has processed what it took.

use std::task::{Context, Poll};

use parking_lot::Mutex;
use tokio::sync::mpsc;

use gdp_e2e::seal::Message;

/// Takes a message, or returns it for the queue.
///
/// The receiving thread of the node calls it, which receives nothing meanwhile. It must return
/// soon. It must not use the subscription, because its lock is held.
pub type MessageSink = Box<dyn FnMut(Message) -> Option<Message> + Send>;

/// The sink of a subscription, if there is one.
#[derive(Default)]
pub struct DirectPath(Mutex<SinkState>);

#[derive(Default)]
struct SinkState {
    sink: Option<MessageSink>,
    /// Whether the application waits for the next message.
    is_waiting: bool,
}

impl DirectPath {
    pub fn set(&self, sink: Option<MessageSink>) {
        // The earlier sink is dropped after the lock.
        let _before = std::mem::replace(&mut self.0.lock().sink, sink);
    }

    /// Passes a message to the sink. Returns it if it belongs into the queue.
    pub fn pass(&self, message: Message, queue: &mpsc::Sender<Message>) -> Option<Message> {
        let state = &mut *self.0.lock();
        match &mut state.sink {
            Some(sink) if state.is_waiting && queue.capacity() == queue.max_capacity() => sink(message),
            _ => Some(message),
        }
    }

    /// Takes the next message from the queue, or waits for it.
    pub fn poll_next(&self, queue: &mut mpsc::Receiver<Message>, context: &mut Context<'_>) -> Poll<Option<Message>> {
        // Locked meanwhile: a message that was taken is no longer in the queue, and not processed.
        let state = &mut *self.0.lock();
        let next = queue.poll_recv(context);
        // A task that has used up its turn waits although there are messages.
        state.is_waiting = next.is_pending() && queue.is_empty();
        next
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/sink.rs"]
mod tests;
