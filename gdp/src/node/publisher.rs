//! The application's sending end of a name.

use std::sync::Arc;
use std::time::SystemTime;

use gdp_wire::{Header, Name, forward};
use zerocopy::IntoBytes;

use super::supervisor::Attachment;
use super::{Feedback, Handle, NodeError, Stated};
use crate::port::{BATCH, OutFrame};
use crate::seal::{Encoding, Segments, Writer};

/// Sends messages to a name. Dropping it withdraws the name.
pub struct Publisher {
    node: Arc<Handle>,
    name: Name,
    writer: Writer,
    feedback: Arc<Feedback>,
    segments: Segments,
    headers: Box<[Header; BATCH]>,
}

impl Publisher {
    pub(super) fn new(node: Arc<Handle>, name: Name, writer: Writer, feedback: Arc<Feedback>) -> Self {
        Self { node, name, writer, feedback, segments: Segments::new(), headers: Box::new([Header::default(); BATCH]) }
    }

    pub fn name(&self) -> Name {
        self.name
    }

    /// What the switch says of this name's frames.
    pub fn feedback(&self) -> &Arc<Feedback> {
        &self.feedback
    }

    /// Seals and sends one message, best effort: `Ok` says that the kernel took all its frames, not that they arrive.
    /// Returns the sequence number. While the link to the switch is lost this fails at once, and nothing is kept; but to a
    /// switch whose daemon fell silent frames are sent on, as long as its data plane answers ([`crate::link::HOLD`]).
    pub async fn send(&mut self, encoding: Encoding, body: &[u8]) -> Result<u64, NodeError> {
        let result = self.try_send(encoding, body).await;
        let counters = &self.node.state.counters;
        if result.is_ok() {
            counters.messages_sent.add(1)
        } else {
            counters.messages_unsent.add(1)
        }
        result
    }

    async fn try_send(&mut self, encoding: Encoding, body: &[u8]) -> Result<u64, NodeError> {
        let attachment = self.node.state.sending_on()?;
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let sequence = self.writer.next_sequence();
        self.writer.seal(now.as_nanos() as u64, encoding, body, attachment.max_payload(), &mut self.segments)?;

        let source = self.node.state.identity.name();
        let mut payloads = self.segments.iter();
        let mut lost = 0;
        while payloads.len() > 0 {
            lost += send_batch(&attachment, &mut self.headers, self.name, source, &mut payloads, &self.node);
            if payloads.len() > 0 {
                // Rings of 256 frames lie behind the socket: let whoever empties them run.
                tokio::task::yield_now().await;
            }
        }
        if lost > 0 { Err(NodeError::NoRoom { lost, of: self.segments.len() }) } else { Ok(sequence) }
    }
}

/// Sends up to [`BATCH`] of the payloads; returns how many of them were lost.
fn send_batch(
    attachment: &Attachment,
    headers: &mut [Header; BATCH],
    destination: Name,
    source: Name,
    payloads: &mut dyn Iterator<Item = &[u8]>,
    node: &Handle,
) -> usize {
    let entry = attachment.entry.get();
    let mut bodies = [&[][..]; BATCH];
    let mut count = 0;
    for body in payloads.take(BATCH) {
        let header = &mut headers[count];
        // The writer keeps payloads within the link's MTU, which 16 bits can express.
        *header = Header::data(destination, source, body.len() as u16);
        forward::stamp(header, &entry, attachment.next_count());
        bodies[count] = body;
        count += 1;
    }
    let to = attachment.link.addr();
    let frames =
        headers.iter().zip(bodies).take(count).map(|(header, body)| OutFrame { to, head: header.as_bytes(), body });
    let sent = attachment.data.send_batch(frames);
    let counters = &node.state.counters;
    counters.frames_sent.add(sent.sent as u64);
    counters.frames_unsent.add(sent.lost as u64);
    sent.lost
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.node.state.withdraw(self.name, Stated::Published);
    }
}
