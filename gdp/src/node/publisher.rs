//! The application's sending end of a name.

use std::pin::pin;
use std::sync::Arc;

use gdp_wire::Name;

use super::outlet::Outlet;
use super::publication::{Publication, Pushed};
use super::state::lock;
use super::{Feedback, Handle, NodeError, Stated};
use crate::seal::{Draft, Encoding};
use crate::transport::TopicCounters;

/// Sends messages to a name. Dropping it withdraws the name; what has not gone yet is lost.
pub struct Publisher {
    node: Arc<Handle>,
    publication: Arc<Publication>,
    feedback: Arc<Feedback>,
}

impl Publisher {
    pub(super) fn new(node: Arc<Handle>, publication: Arc<Publication>, feedback: Arc<Feedback>) -> Self {
        Self { node, publication, feedback }
    }

    pub fn name(&self) -> Name {
        self.publication.name
    }

    /// What the switch says of this name's frames.
    pub fn feedback(&self) -> &Arc<Feedback> {
        &self.feedback
    }

    /// Readers that are attached at the moment, as far as is known here. What is sent without any goes nowhere.
    pub fn readers(&self) -> usize {
        self.publication.readers()
    }

    /// What became of messages and frames so far.
    pub fn counters(&self) -> TopicCounters {
        lock(&self.node.state.outlet.uplink).counters(self.publication.topic).unwrap_or_default()
    }

    /// Seals one message and sends it; those that come within 100 µs of one another share a signature and frames. It goes as [`PublishOptions`](super::PublishOptions) say: `Ok` says that it is on its way or waits for
    /// its turn. Returns the sequence number. Waits only if the name is reliable and the history full; a message that it was
    /// cancelled in waiting for is sent all the same. While the link to the switch is lost, what is best effort fails at once, and
    /// what is reliable is kept; but to a switch whose daemon fell silent frames are sent on, as long as its data plane answers
    /// ([`crate::link::HOLD`]).
    pub async fn send(&mut self, encoding: Encoding, body: &[u8]) -> Result<u64, NodeError> {
        self.send_batch(&[Draft::new(encoding, body)]).await
    }

    /// Returns when a message that is sent next goes right behind the one that goes at the moment: it would replace none that still
    /// waits, and wait for no room itself. For publishers of what is best effort that can make messages faster than they go, and had
    /// rather not seal what newer ones replace. What goes nowhere has its turn at once.
    pub async fn ready(&self) -> Result<(), NodeError> {
        let outlet = &self.node.state.outlet;
        loop {
            let mut room = pin!(self.publication.room.notified());
            room.as_mut().enable();
            self.publication.check()?;
            if let Err(NodeError::Closed) = outlet.sending_on() {
                return Err(NodeError::Closed);
            }
            if lock(&outlet.uplink).has_turn(self.publication.topic) {
                return Ok(());
            }
            room.await;
        }
    }

    /// Several messages under one signature; small ones share frames. Returns the sequence number of the first.
    pub async fn send_batch(&mut self, messages: &[Draft<'_>]) -> Result<u64, NodeError> {
        let counters = self.node.state.counters.clone();
        let result = self.try_send(messages).await;
        let count = if result.is_ok() { &counters.messages_sent } else { &counters.messages_unsent };
        count.add(messages.len() as u64);
        result
    }

    async fn try_send(&mut self, messages: &[Draft<'_>]) -> Result<u64, NodeError> {
        send_through(&self.publication, &self.node.state.outlet, messages, |_| {}).await
    }
}

/// Seals messages and sends them; waits for room if it must. `begun` is told the sequence of the first before anything goes.
pub(super) async fn send_through(
    publication: &Publication,
    outlet: &Outlet,
    messages: &[Draft<'_>],
    begun: impl FnOnce(u64),
) -> Result<u64, NodeError> {
    match outlet.sending_on() {
        Err(NodeError::Detached(_)) if publication.waits_for_links() => {}
        link => drop(link?),
    }
    let mut begun = Some(begun);
    loop {
        // One that was cancelled may be waiting still.
        until_taken(publication, outlet).await?;
        let Some((first, pushed)) = publication.push(outlet, messages, &mut begun)? else { continue };
        match pushed {
            Pushed::Gathered(None) => {}
            Pushed::Gathered(Some(until)) => outlet.gather(publication.topic, until),
            Pushed::Taken => outlet.send(),
            Pushed::Waits => {
                outlet.send();
                until_taken(publication, outlet).await?;
            }
        }
        return Ok(first);
    }
}

/// Returns once nothing waits for room any more.
async fn until_taken(publication: &Publication, outlet: &Outlet) -> Result<(), NodeError> {
    loop {
        let mut room = pin!(publication.room.notified());
        room.as_mut().enable();
        if let Err(NodeError::Closed) = outlet.sending_on() {
            return Err(NodeError::Closed);
        }
        if let Pushed::Taken = publication.push_waiting(outlet)? {
            return Ok(());
        }
        outlet.send();
        room.await;
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.publication.finish(&self.node.state.outlet);
        self.node.state.withdraw(self.publication.name, Stated::Published);
    }
}
