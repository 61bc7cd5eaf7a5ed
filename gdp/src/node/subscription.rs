//! The application's handle for receiving a name.

use gdp_wire::Name;
use std::sync::Arc;
use std::task::{Context, Poll};

use super::counters::{Meter, SubscriptionCounters};
use super::ending::{Ended, Ending};
use super::error::NodeError;
use super::handle::Handle;
use super::queue::Queue;
use super::sink::MessageSink;
use super::statement::{Stated, Statement};
use gdp_core::cert::Reading;
use gdp_e2e::seal::Message;

/// Receives the verified messages of a name. Dropping it ends the subscription.
pub struct Subscription {
    node: Arc<Handle>,
    queue: Queue,
    ending: Arc<Ending>,
}

impl Subscription {
    pub(super) fn new(node: Arc<Handle>, queue: Queue, ending: Arc<Ending>) -> Self {
        Self { node, queue, ending }
    }

    pub fn name(&self) -> Name {
        self.queue.name
    }

    /// Returns the next message, or `None` after the node closes or the grant ends
    /// ([`Self::ended`]). Safe to cancel.
    pub async fn recv(&mut self) -> Option<Message> {
        self.queue.recv().await
    }

    /// Polls for the next message as [`Self::recv`] does.
    pub fn poll_recv(&mut self, context: &mut Context<'_>) -> Poll<Option<Message>> {
        self.queue.poll_recv(context)
    }

    /// Sets a function that takes messages on the receiving thread, before they are queued. It is
    /// asked only while [`Self::recv`] waits and nothing is queued, so that messages stay in their
    /// order. `None` queues all messages.
    pub fn set_sink(&mut self, sink: Option<MessageSink>) {
        self.queue.shared.direct.set(sink);
    }

    /// Waits until receiving ends, and returns the reason.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.ending.wait()
    }

    /// Continues to read with this grant; no message is lost, and writers do not notice. Call it
    /// before the current grant expires.
    ///
    /// If the RIB refuses the new grant, the current one stays in force. Without a link, the RIB
    /// receives the new grant over the next link.
    pub async fn renew(&mut self, grant: Reading) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Read { proof, grant };
        self.node.state.renew(self.queue.name, Stated::Subscribed, renewed).await
    }

    /// Returns the counters of messages and segments.
    pub fn counters(&self) -> SubscriptionCounters {
        self.queue.shared.counters()
    }

    /// Returns a meter that reads the same counters at any time, from any task.
    pub fn meter(&self) -> Meter<SubscriptionCounters> {
        let shared = self.queue.shared.clone();
        Meter::new(move || shared.counters())
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.set_sink(None);
        self.node.state.withdraw(self.queue.name, Stated::Subscribed);
    }
}
