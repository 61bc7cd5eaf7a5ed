//! The application's handle for publishing a name.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;

use super::counters::{Meter, PublisherCounters};
use super::ending::Ended;
use super::error::{NodeError, Unflushed};
use super::feedback::Feedback;
use super::handle::Handle;
use super::immediate_sender::ImmediateSender;
use super::publication::Publication;
use super::sealer::Pushed;
use super::send_path::SendPath;
use super::statement::{Stated, Statement};
use gdp_core::cert::{AdCert, Issued};
use gdp_e2e::seal::{Draft, Encoding};

/// Interval of the checks in [`Publisher::flush`].
const LOOK: Duration = Duration::from_millis(2);

/// Sends messages to a name. Dropping it withdraws the name. Unsent messages are then lost, and
/// nothing is retransmitted: see [`Self::close`].
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

    /// Returns the switch's error reports about this name's frames.
    pub fn feedback(&self) -> &Arc<Feedback> {
        &self.feedback
    }

    /// Returns the number of attached readers that this node knows of. Messages without readers are
    /// sent to no entity.
    pub fn readers(&self) -> usize {
        self.publication.readers()
    }

    /// Returns the counters of messages and frames.
    pub fn counters(&self) -> PublisherCounters {
        counters(&self.publication, &self.feedback)
    }

    /// Returns a meter that reads the same counters at any time, from any task.
    pub fn meter(&self) -> Meter<PublisherCounters> {
        let (publication, feedback) = (self.publication.clone(), self.feedback.clone());
        Meter::new(move || counters(&publication, &feedback))
    }

    /// Returns a sender of this name for other threads. It sends nothing after the publisher was
    /// dropped.
    pub fn immediate_sender(&self) -> ImmediateSender {
        let state = &self.node.state;
        ImmediateSender::new(self.publication.clone(), state.send_path.clone(), state.counters.clone())
    }

    /// Waits until nothing can be sent any more, and returns the reason.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.publication.ending.wait()
    }

    /// Continues to publish with this certificate, in the same session; readers miss no message.
    /// Call it before the current certificate expires.
    ///
    /// If the RIB refuses the new certificate, the current one stays in force. Without a link, the
    /// RIB receives the new certificate over the next link.
    pub async fn renew(&mut self, ad_cert: Issued<AdCert>) -> Result<(), NodeError> {
        self.renew_shared(ad_cert).await
    }

    /// [Renews](Self::renew) a publisher that several tasks share.
    pub async fn renew_shared(&self, ad_cert: Issued<AdCert>) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Write { proof, ad_cert };
        self.node.state.renew(self.publication.name, Stated::Published, renewed).await
    }

    /// Waits until all messages have left this host. If the name is reliable, also waits until
    /// every live reader that requests every message has acknowledged them.
    ///
    /// # Errors
    ///
    /// Returns the unfinished messages after `patience`. A best-effort publisher without a link
    /// fails at once.
    pub async fn flush(&mut self, patience: Duration) -> Result<(), NodeError> {
        self.flush_shared(patience).await
    }

    /// [Flushes](Self::flush) a publisher that several tasks share.
    pub async fn flush_shared(&self, patience: Duration) -> Result<(), NodeError> {
        let (publication, send_path) = (&self.publication, &self.node.state.send_path);
        let deadline = tokio::time::Instant::now() + patience;
        send_path.finish(publication);
        loop {
            publication.sealer.check()?;
            let unfinished = publication.unfinished();
            if unfinished == Unflushed::default() {
                return Ok(());
            }
            send_path.check_link(publication)?;
            if tokio::time::Instant::now() >= deadline {
                return Err(unfinished.into());
            }
            tokio::time::sleep(LOOK).await;
        }
    }

    /// [Flushes](Self::flush) and then withdraws the name.
    pub async fn close(mut self, patience: Duration) -> Result<(), NodeError> {
        self.flush(patience).await
    }

    /// Seals and sends one message, and returns its sequence number.
    ///
    /// Messages within 100 µs of one another share a signature and frames. In a node that would
    /// sign more than 3000 times a second, messages within 8 ms do. `Ok` means that the message is
    /// sent or queued, by the [`PublishOptions`](super::PublishOptions).
    ///
    /// Waits only if the name is reliable and the history is full. If a waiting call is cancelled,
    /// the message is sent nevertheless.
    ///
    /// Without a link to the switch, a best-effort message fails at once and a reliable one is
    /// stored. If the switch's daemon became silent, frames are still sent while its data plane
    /// answers ([`gdp_core::peer::GRACEFUL_RESTART_TIME`]).
    pub async fn send(&mut self, encoding: Encoding, body: &[u8]) -> Result<u64, NodeError> {
        self.send_batch(&[Draft::new(encoding, body)]).await
    }

    /// Waits until a new message would directly follow the one in transmission. It would then
    /// replace no queued message and wait for no space.
    ///
    /// For best-effort publishers that produce messages faster than the link sends them, and that
    /// avoid sealing messages which newer ones replace. Without readers it returns at once. Without
    /// a link it fails as [`Self::send`] does.
    pub async fn ready(&self) -> Result<(), NodeError> {
        let send_path = &self.node.state.send_path;
        loop {
            let mut room = pin!(self.publication.room.notified());
            room.as_mut().enable();
            self.publication.sealer.check()?;
            send_path.check_link(&self.publication)?;
            if send_path.scheduler.uplink().has_turn(self.publication.topic()) {
                return Ok(());
            }
            room.await;
        }
    }

    /// Sends several messages under one signature; small ones share frames. Returns the sequence
    /// number of the first.
    pub async fn send_batch(&mut self, messages: &[Draft<'_>]) -> Result<u64, NodeError> {
        self.send_shared(messages).await
    }

    /// Sends messages as [`Self::send_batch`] does, from one of several tasks. Which task's message
    /// is first is not determined.
    pub async fn send_shared(&self, messages: &[Draft<'_>]) -> Result<u64, NodeError> {
        let counters = self.node.state.counters.clone();
        let result = self.try_send(messages).await;
        let count = if result.is_ok() { &counters.messages_sent } else { &counters.messages_unsent };
        count.add(messages.len() as u64);
        result
    }

    /// Sends a message about the name to current readers, and to late-joining readers before the
    /// latched messages. Replaces the previously pinned message. Readers may receive it several
    /// times.
    pub fn pin(&self, encoding: Encoding, body: &[u8]) {
        self.publication.sealer.pin(encoding, body);
    }

    /// Sends a message about the name to current readers. It is not latched.
    pub fn mention(&self, encoding: Encoding, body: &[u8]) {
        self.publication.sealer.mention(encoding, body);
    }

    /// Latches the last `most` messages of this origin, until it is [forgotten](Self::forget).
    /// Overrides [`PublishOptions::latched`](super::PublishOptions::latched).
    pub fn latch(&self, origin: &[u8], most: usize) {
        self.publication.sealer.limit_latched(origin, most);
    }

    /// Removes the [latched](super::PublishOptions::latched) messages of this origin. Late-joining
    /// readers no longer receive them.
    pub fn forget(&self, origin: &[u8]) {
        self.publication.sealer.forget(origin);
    }

    async fn try_send(&self, messages: &[Draft<'_>]) -> Result<u64, NodeError> {
        send_through(&self.publication, &self.node.state.send_path, messages, |_| {}).await
    }
}

fn counters(publication: &Publication, feedback: &Feedback) -> PublisherCounters {
    PublisherCounters {
        topic: publication.counters(),
        readers: publication.readers(),
        incompatible_readers: publication.incompatible_readers(),
        refused: feedback.errors(),
    }
}

/// Seals and sends messages, and waits for space if necessary. Passes the sequence number of the
/// first message to `begun` before anything is sent.
pub async fn send_through(
    publication: &Publication,
    send_path: &SendPath,
    messages: &[Draft<'_>],
    begun: impl FnOnce(u64),
) -> Result<u64, NodeError> {
    send_path.check_link(publication)?;
    let mut begun = Some(begun);
    loop {
        // A message of a cancelled call may still be waiting.
        until_taken(publication, send_path).await?;
        let Some((first, pushed)) = publication.sealer.push(messages, &mut begun)? else { continue };
        match pushed {
            Pushed::Batched(None) => {}
            Pushed::Batched(Some(until)) => send_path.scheduler.batch_until(publication.topic(), until),
            Pushed::Taken => send_path.send(),
            Pushed::Waits => {
                send_path.send();
                until_taken(publication, send_path).await?;
            }
        }
        return Ok(first);
    }
}

/// Returns once no message waits for space.
async fn until_taken(publication: &Publication, send_path: &SendPath) -> Result<(), NodeError> {
    loop {
        let mut room = pin!(publication.room.notified());
        room.as_mut().enable();
        if let Err(NodeError::Closed) = send_path.links.sending_on() {
            return Err(NodeError::Closed);
        }
        if let Pushed::Taken = publication.sealer.push_waiting()? {
            return Ok(());
        }
        send_path.send();
        room.await;
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.node.state.send_path.finish(&self.publication);
        self.node.state.withdraw(self.publication.name, Stated::Published);
    }
}
