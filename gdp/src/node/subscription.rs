//! The application's receiving end of a name.

use gdp_wire::Name;
use std::sync::Arc;

use super::counters::{Meter, SubscriptionCounters};
use super::ending::{Ended, Ending};
use super::error::NodeError;
use super::handle::Handle;
use super::queue::Queue;
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

    /// The next message; `None` once the node is closed, or the grant holds no more
    /// ([`Self::ended`]). Safe to cancel.
    pub async fn recv(&mut self) -> Option<Message> {
        self.queue.recv().await
    }

    /// Waits until nothing is received any more, and says why.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.ending.wait()
    }

    /// Reads on by this grant; nothing is missed, and writers do not notice. To be done before the
    /// present one ends. A refusal of the RIB leaves the present one in force; while there is no
    /// link, the RIB is given the new one with the next.
    pub async fn renew(&mut self, grant: Reading) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Read { proof, grant };
        self.node.state.renew(self.queue.name, Stated::Subscribed, renewed).await
    }

    /// What became of messages and segments so far.
    pub fn counters(&self) -> SubscriptionCounters {
        self.queue.shared.counters()
    }

    /// The same at any time, from any task.
    pub fn meter(&self) -> Meter<SubscriptionCounters> {
        let shared = self.queue.shared.clone();
        Meter::new(move || shared.counters())
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.node.state.withdraw(self.queue.name, Stated::Subscribed);
    }
}
