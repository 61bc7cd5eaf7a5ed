//! The send path, in three stages.
//!
//! A [sealer](super::sealer) per topic seals messages, the [scheduler](super::scheduler) queues
//! them, the [sender](super::sender) sends them. Each stage has its own lock and knows only the
//! stages below it, so locks are taken downward.
//!
//! [`SendPath`] drives the stages. Publishers themselves send what may leave at once, so a message
//! on an idle link passes to no other thread. The sending thread sends delayed frames, and passes
//! events of the scheduler to the sealers.

use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;
use parking_lot::{Mutex, MutexGuard};
use tokio::sync::Notify;

use super::attachment::Attachment;
use super::clock::Clock;
use super::clock_differences::ClockDifferences;
use super::config::LinkConfig;
use super::counters::Counters;
use super::error::NodeError;
use super::links::{Connection, Links, Rerouted};
use super::pairs::Pairs;
use super::publication::Publication;
use super::publications::Publications;
use super::scheduler::{Due, Polled, Scheduler};
use super::sealer::Pushed;
use super::sender::Sender;
use gdp_core::identity::Identity;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::transport::{Output, TopicId};

/// Maximum number of batches that a publisher sends itself. The sending thread sends the rest of a
/// large message.
const OWN_BATCHES: usize = 4;

/// Maximum time that [`SendPath::finish`] waits for another thread to send its frames.
const LONGEST_TURN: Duration = Duration::from_millis(100);

pub struct SendPath {
    pub clock: Clock,
    pub counters: Arc<Counters>,
    pub links: Arc<Links>,
    pub scheduler: Arc<Scheduler>,
    pub publications: Publications,
    /// The pair keys for feedback to single counterparts.
    pub pairs: Arc<Pairs>,
    /// The counterparts whose clocks differ.
    pub clocks: ClockDifferences,
    /// Notified when there may be key boxes for the RIB, or latched messages for a reader.
    pub upkeep: Notify,
    /// The sending thread waits for this lock; publishers only try it.
    sender: Mutex<Sender>,
}

impl SendPath {
    pub fn new(identity: &Identity, counters: Arc<Counters>, configs: &[LinkConfig]) -> Self {
        let links = Arc::new(Links::new(identity.name(), counters.clone(), configs));
        let scheduler = Arc::new(Scheduler::new(links.clone()));
        Self {
            clock: scheduler.clock,
            counters,
            scheduler,
            publications: Publications::default(),
            pairs: Arc::new(Pairs::new(identity.clone())),
            clocks: ClockDifferences::default(),
            upkeep: Notify::new(),
            sender: Mutex::new(Sender::new(links.clone())),
            links,
        }
    }

    /// Sets the connection of a link.
    pub fn set_connection(&self, lane: usize, connection: Connection) {
        self.reroute(self.links.set_connection(self.clock.now(), lane, connection));
    }

    /// Updates the reason why a link is still down.
    pub fn still_lost(&self, lane: usize, why: String) {
        self.reroute(self.links.still_lost(self.clock.now(), lane, why));
    }

    /// Ends the use of a stale link.
    pub fn end_stale(&self, lane: usize) {
        self.reroute(self.links.end_stale(self.clock.now(), lane));
    }

    /// Resumes the use of a stale link.
    pub fn resume_stale(&self, attachment: &Arc<Attachment>) {
        self.reroute(self.links.resume_stale(self.clock.now(), attachment));
    }

    /// Sets whether the switch is silent on a link that is up.
    pub fn set_silent(&self, lane: usize, silent: bool) {
        self.reroute(self.links.set_silent(self.clock.now(), lane, silent));
    }

    /// Sets whether this machine has changed networks without an answer from the switch since.
    /// Applies to a link that is up.
    pub fn set_moved(&self, lane: usize, moved: bool) {
        self.reroute(self.links.set_moved(self.clock.now(), lane, moved));
    }

    fn reroute(&self, rerouted: Option<Rerouted>) {
        let Some(Rerouted { main, is_attached }) = rerouted else { return };
        if let Some((from, to)) = main {
            tracing::info!(from, to, "another link is the main one");
            self.scheduler.update_budget();
            self.links.slots()[to].unstated.notify_one();
        }
        self.scheduler.wake();
        if !is_attached {
            self.wake_publishers();
        }
    }

    /// Makes waiting publishers check whether to continue waiting.
    fn wake_publishers(&self) {
        self.publications.all().iter().for_each(|publication| publication.room.notify_waiters());
    }

    /// Stops all sending, and ends [`Self::pump`].
    pub fn shut(&self) {
        self.links.shut();
        self.scheduler.stop();
        self.wake_publishers();
    }

    pub fn close(&self, name: &Name) {
        self.publications.remove(name).into_iter().for_each(|publication| publication.close());
    }

    /// Checks that a publication can send: best effort fails without a link, reliable ones wait for
    /// a link.
    pub fn check_link(&self, publication: &Publication) -> Result<(), NodeError> {
        match self.links.sending_on() {
            Err(NodeError::Detached(_)) if publication.is_reliable() => Ok(()),
            link => link.map(drop),
        }
    }

    /// Seals and sends the batch of a publication without further waiting.
    ///
    /// Waits for a thread that is sending, because the caller may close the publication next. A
    /// closed publication has no frames, so that thread would not send them.
    pub fn finish(&self, publication: &Publication) {
        if publication.sealer.seal_batch(u64::MAX).is_ok() {
            self.send_batches(self.sender.try_lock_for(LONGEST_TURN), OWN_BATCHES);
        }
    }

    /// Sends frames that may leave now. The sending thread sends the rest.
    pub fn send(&self) {
        self.send_batches(self.sender.try_lock(), OWN_BATCHES);
    }

    /// Sends as [`Self::send`], but at most one batch. For threads that must not be long away from
    /// other work.
    pub fn send_one_batch(&self) {
        self.send_batches(self.sender.try_lock(), 1);
    }

    fn send_batches(&self, sender: Option<MutexGuard<'_, Sender>>, batches: usize) {
        let next = match sender {
            Some(mut sender) => self.drain(&mut sender, batches),
            // The current sender may already have polled.
            None => Some(0),
        };
        self.scheduler.plan(next);
    }

    /// Sends feedback to a counterpart in one frame, if it is one and there is a link. The frame is
    /// not retransmitted. `feedback` has at most [`gdp_e2e::feedback_wire::MAX_FEEDBACK`] bytes.
    pub fn tell(&self, peer: &Name, feedback: &[Feedback]) {
        let mut payload = Vec::new();
        match self.pairs.seal(peer, feedback, &mut payload) {
            Some(Ok(())) => {}
            Some(Err(error)) => return tracing::warn!(%peer, %error, "feedback could not be sealed"),
            None => return,
        }
        let doubled = feedback.iter().any(|feedback| self.scheduler.is_doubled(&feedback.name()));
        if self.links.send_one(*peer, &payload, doubled) {
            self.counters.feedback_sent.add(1);
        }
    }

    /// Runs the sending thread until [`Self::shut`].
    pub fn pump(&self) {
        loop {
            let next = self.drain(&mut self.sender.lock(), usize::MAX);
            let Some(Due { now, batches, events }) = self.scheduler.wait(next) else {
                // Counts the remaining copies as dropped.
                self.sender.lock().active();
                return;
            };
            batches.into_iter().for_each(|topic| self.seal_batch(topic, now));
            events.into_iter().for_each(|event| self.handle(event));
        }
    }

    /// Sends frames that may leave now, up to this number of batches. Returns the time of the next
    /// output.
    fn drain(&self, sender: &mut Sender, batches: usize) -> Option<u64> {
        let active = sender.active();
        let max_payload = active.max_payload(self.scheduler.has_doubled())?;
        for _ in 0..batches {
            let Polled { now, next, rooms } = self.scheduler.poll(max_payload, &mut sender.transmits);
            // Publishers should be ready again before all current frames have left.
            rooms.into_iter().for_each(|topic| self.make_room(topic));
            let next = next.into_iter().chain(sender.send(now, &active)).min();
            if next != Some(0) {
                return next;
            }
        }
        Some(0)
    }

    fn make_room(&self, topic: TopicId) {
        let Some(publication) = self.publications.of(topic) else { return };
        // The waiting message is sent even if its publisher no longer waits.
        if !matches!(publication.sealer.push_waiting(), Ok(Pushed::Waits)) {
            publication.room.notify_waiters();
        }
    }

    fn seal_batch(&self, topic: TopicId, due: u64) {
        let Some(publication) = self.publications.of(topic) else { return };
        if let Err(error) = publication.sealer.seal_batch(due) {
            tracing::warn!(name = %publication.name, %error, "messages are lost that waited for others");
        }
    }

    /// Passes an event of the scheduler to the sealer of its topic.
    fn handle(&self, event: Output) {
        match event {
            Output::Send(_) | Output::Room { .. } => unreachable!("the scheduler returns them apart"),
            Output::Reseal { topic, message } => {
                self.publications.of(topic).into_iter().for_each(|publication| publication.sealer.reseal(&message));
            }
            Output::Heartbeat { topic, next, oldest } => {
                let Some(publication) = self.publications.of(topic) else { return };
                let (name, mut payload) = (publication.name, Vec::new());
                match publication.sealer.heartbeat(next, oldest, &mut payload) {
                    Ok(()) => _ = self.links.send_one(name, &payload, self.scheduler.is_doubled(&name)),
                    Err(error) => tracing::warn!(%name, %error, "a heartbeat could not be sealed"),
                }
            }
            Output::Unavailable { topic, reader, oldest } => {
                let Some(publication) = self.publications.of(topic) else { return };
                let (name, session) = (publication.name, publication.sealer.session);
                self.tell(&reader, &[Feedback::Unavailable { name, session, oldest }]);
            }
        }
    }
}
