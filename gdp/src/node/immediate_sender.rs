//! Sending without waiting, from any thread.

use std::sync::Arc;

use super::counters::Counters;
use super::error::NodeError;
use super::publication::Publication;
use super::sealer::Pushed;
use super::send_path::SendPath;
use gdp_e2e::seal::Draft;

/// Sends messages of a [`Publisher`](super::Publisher) from any thread, at once or not at all. It
/// does not keep the name published.
#[derive(Clone)]
pub struct ImmediateSender {
    publication: Arc<Publication>,
    send_path: Arc<SendPath>,
    counters: Arc<Counters>,
}

impl ImmediateSender {
    pub(super) fn new(publication: Arc<Publication>, send_path: Arc<SendPath>, counters: Arc<Counters>) -> Self {
        Self { publication, send_path, counters }
    }

    /// Seals one message as [`Publisher::send`](super::Publisher::send) does, and sends its frames
    /// as far as they may leave. Returns false if an earlier message still waits for space; the
    /// message was not taken then.
    pub fn send(&self, message: &Draft<'_>) -> Result<bool, NodeError> {
        let Self { publication, send_path, .. } = self;
        send_path.check_link(publication)?;
        let messages = std::slice::from_ref(message);
        let Some((_, pushed)) = publication.sealer.push(messages, &mut None::<fn(u64)>)? else { return Ok(false) };
        match pushed {
            Pushed::Batched(None) => {}
            Pushed::Batched(Some(until)) => send_path.scheduler.batch_until(publication.topic(), until),
            // The sending thread continues what waits for space.
            Pushed::Taken | Pushed::Waits => send_path.send_one_batch(),
        }
        self.counters.messages_sent.add(1);
        Ok(true)
    }
}
