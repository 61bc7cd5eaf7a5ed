//! The application's sending end of a name.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;

use super::counters::{Meter, PublisherCounters};
use super::ending::Ended;
use super::error::{NodeError, Unflushed};
use super::feedback::Feedback;
use super::handle::Handle;
use super::publication::Publication;
use super::sealer::Pushed;
use super::send_path::SendPath;
use super::statement::{Stated, Statement};
use gdp_core::cert::{AdCert, Issued};
use gdp_e2e::seal::{Draft, Encoding};

/// How often it is looked whether everything has gone.
const LOOK: Duration = Duration::from_millis(2);

/// Sends messages to a name. Dropping it withdraws the name; what has not gone yet is lost, and
/// nothing is repaired any more: see [`Self::close`].
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

    /// Readers that are attached at the moment, as far as is known here. What is sent without any
    /// goes nowhere.
    pub fn readers(&self) -> usize {
        self.publication.readers()
    }

    /// What became of messages and frames so far.
    pub fn counters(&self) -> PublisherCounters {
        counters(&self.publication, &self.feedback)
    }

    /// The same at any time, from any task.
    pub fn meter(&self) -> Meter<PublisherCounters> {
        let (publication, feedback) = (self.publication.clone(), self.feedback.clone());
        Meter::new(move || counters(&publication, &feedback))
    }

    /// Waits until nothing can be sent any more, and says why.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.publication.ending.wait()
    }

    /// Publishes on by this certificate, in the same session; readers miss nothing. To be done
    /// before the present one ends. A refusal of the RIB leaves the present one in force; while
    /// there is no link, the RIB is given the new one with the next.
    pub async fn renew(&mut self, ad_cert: Issued<AdCert>) -> Result<(), NodeError> {
        let renewed = |proof| Statement::Write { proof, ad_cert };
        self.node.state.renew(self.publication.name, Stated::Published, renewed).await
    }

    /// Returns once all that was sent has left this host, and, if the name is reliable, every
    /// reader that is live and asks for every message has acknowledged it; or after `patience`,
    /// with what is left. What is best effort fails at once while there is no link.
    pub async fn flush(&mut self, patience: Duration) -> Result<(), NodeError> {
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

    /// [Flushes](Self::flush), and then withdraws the name.
    pub async fn close(mut self, patience: Duration) -> Result<(), NodeError> {
        self.flush(patience).await
    }

    /// Seals one message and sends it; those that come within 100 µs of one another share a
    /// signature and frames, and of a node that would sign more than 3000 times a second those
    /// within 8 ms. It goes as [`PublishOptions`](super::PublishOptions) say: `Ok` says that it is
    /// on its way or waits for its turn. Returns the sequence number. Waits only if the name is
    /// reliable and the history full; a message that it was cancelled in waiting for is sent all
    /// the same. While the link to the switch is lost, what is best effort fails at once, and what
    /// is reliable is kept; but to a switch whose daemon fell silent frames are sent on, as long as
    /// its data plane answers ([`gdp_core::peer::GRACEFUL_RESTART_TIME`]).
    pub async fn send(&mut self, encoding: Encoding, body: &[u8]) -> Result<u64, NodeError> {
        self.send_batch(&[Draft::new(encoding, body)]).await
    }

    /// Returns when a message that is sent next goes right behind the one that goes at the moment:
    /// it would replace none that still waits, and wait for no room itself. For publishers of what
    /// is best effort that can make messages faster than they go, and had rather not seal what
    /// newer ones replace. What goes nowhere has its turn at once; what [`Self::send`] would fail
    /// with for want of a link, this does as well.
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

    /// Several messages under one signature; small ones share frames. Returns the sequence number
    /// of the first.
    pub async fn send_batch(&mut self, messages: &[Draft<'_>]) -> Result<u64, NodeError> {
        let counters = self.node.state.counters.clone();
        let result = self.try_send(messages).await;
        let count = if result.is_ok() { &counters.messages_sent } else { &counters.messages_unsent };
        count.add(messages.len() as u64);
        result
    }

    /// Sends a message about the name, now and to every reader that comes later, before what is
    /// latched; in place of the one that was pinned before. Readers may get it several times.
    pub fn pin(&self, encoding: Encoding, body: &[u8]) {
        self.publication.sealer.pin(encoding, body);
    }

    /// Sends a message about the name to those who read it now. It is not latched.
    pub fn mention(&self, encoding: Encoding, body: &[u8]) {
        self.publication.sealer.mention(encoding, body);
    }

    /// Latches the last `most` messages of this origin, whatever
    /// [`PublishOptions::latched`](super::PublishOptions::latched) says of the others; until it is
    /// [forgotten](Self::forget).
    pub fn latch(&self, origin: &[u8], most: usize) {
        self.publication.sealer.limit_latched(origin, most);
    }

    /// Sends readers that come later nothing more of what was
    /// [latched](super::PublishOptions::latched) with this origin.
    pub fn forget(&self, origin: &[u8]) {
        self.publication.sealer.forget(origin);
    }

    async fn try_send(&mut self, messages: &[Draft<'_>]) -> Result<u64, NodeError> {
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

/// Seals messages and sends them; waits for room if it must. `begun` gets the sequence of the
/// first before anything goes.
pub async fn send_through(
    publication: &Publication,
    send_path: &SendPath,
    messages: &[Draft<'_>],
    begun: impl FnOnce(u64),
) -> Result<u64, NodeError> {
    send_path.check_link(publication)?;
    let mut begun = Some(begun);
    loop {
        // One that was cancelled may be waiting still.
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

/// Returns once nothing waits for room any more.
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
