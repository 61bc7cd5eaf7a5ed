//! The thread that moves data frames from the sockets to the subscriptions.
//!
//! It checks the hop tag, finds the reader of the destination, and queues messages. It also
//! dispatches feedback from counterparts. Only this thread accesses the readers; other tasks send
//! commands, which take effect before the next frames are read.

use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use gdp_wire::{Counter, FrameType, Header, Name, forward};
use zerocopy::FromBytes;

use super::clock_check::ahead;
use super::command::Command;
use super::counters::Counters;
use super::early_frames::EarlyFrames;
use super::feedback::Feedbacks;
use super::ingress::{Ingress, Ingresses};
use super::outgoing_feedback::OutgoingFeedback;
use super::send_path::SendPath;
use super::subscription_receiver::{Change, SubscriptionReceiver, Verdict};
use gdp_core::peer::MAX_LANES;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::keys::{PairError, PairOpener};
use gdp_e2e::seal::{DropReason, SEGMENT_VERSION};
use gdp_link::port::{DataSocket, InFrame, RecvBatch, WakeEvent};

/// Maximum sleep of the thread, if nothing is due earlier.
const LONGEST_SLEEP: Duration = Duration::from_secs(3600);

/// Number of frames of a socket after which timers are looked at, and commands.
const MOST_FRAMES: usize = 2048;

/// A batch of fewer frames has emptied the socket. So a short message costs no second call.
const FEW_FRAMES: usize = 8;

/// Reports that are due within this time travel with other feedback to the same writer, in
/// nanoseconds. Bounds the subscriptions that are looked at for it.
const TOGETHER: u64 = 50_000_000;
const MOST_TOGETHER: usize = 256;

/// The ECN bits of [`Header::flags`], and their value after congestion (RFC 3168).
const ECN: u8 = 0b11;
const CONGESTED: u8 = 0b11;

pub struct Receiver {
    pub commands: mpsc::Receiver<Command>,
    /// Set after a command was queued.
    pub wake: Arc<WakeEvent>,
    pub send_path: Arc<SendPath>,
    pub feedback: Arc<Feedbacks>,
}

impl Receiver {
    /// Runs until the stop command, or until all senders of commands are dropped.
    pub fn run(self) {
        let mut subscriptions = Subscriptions::new(self.send_path, self.feedback);
        // Indexed by lane.
        let mut attached: [Option<Socket>; MAX_LANES] = Default::default();
        let mut batch = None;
        let mut rest = Rest::default();
        loop {
            loop {
                match self.commands.try_recv() {
                    Ok(Command::Attach { attachment, stale }) => {
                        let place = &mut attached[usize::from(attachment.lane)];
                        let earlier = place.take().map(|socket| socket.links);
                        let stale = stale.map(|(silent, until)| (Ingress::of(&silent), until));
                        let links = Ingresses::after(earlier, Ingress::of(&attachment), stale);
                        *place = Some(Socket { data: attachment.data.clone(), largest: attachment.largest, links });
                    }
                    Ok(Command::Subscribe { name, receiver }) => drop(subscriptions.receivers.insert(name, receiver)),
                    Ok(Command::Unsubscribe { name }) => subscriptions.remove(&name),
                    Ok(Command::Change { name, changes }) => subscriptions.change(name, changes),
                    Ok(Command::Resume { name }) => subscriptions.poll(&name),
                    Err(mpsc::TryRecvError::Empty) => break,
                    Ok(Command::Stop) | Err(mpsc::TryRecvError::Disconnected) => return,
                }
            }
            let mut received = false;
            subscriptions.is_amid = false;
            for place in &mut attached {
                let Some(Socket { data, largest, links }) = place else { continue };
                let batch = batch.get_or_insert_with(|| RecvBatch::new(*largest));
                if batch.largest() < *largest {
                    *batch = RecvBatch::new(*largest);
                }
                // A thread that had no processor finds frames here and overdue timers. What is here
                // is not missing.
                let mut read = 0;
                while read < MOST_FRAMES {
                    match data.try_recv_batch(batch) {
                        Ok(0) => break,
                        Ok(frames) => {
                            (received, read) = (true, read + frames);
                            links.refresh();
                            subscriptions.take(batch, links);
                            if frames < FEW_FRAMES {
                                break;
                            }
                        }
                        Err(error) => {
                            // The link is about to be lost as well. The next link provides a new
                            // socket.
                            tracing::debug!(%error, "the data socket failed");
                            *place = None;
                            break;
                        }
                    }
                }
            }
            subscriptions.poll_touched();
            subscriptions.tick();
            subscriptions.send_feedback();
            if received {
                rest.on_frames(subscriptions.is_amid);
            } else if rest.is_near() {
                std::hint::spin_loop();
                continue;
            }
            if !received {
                let sockets = attached.iter().flatten();
                let expiry = sockets.clone().filter_map(|socket| socket.links.next_expiry()).min();
                let idle = subscriptions.idle(expiry);
                if DataSocket::wait_any(sockets.map(|socket| &*socket.data), &self.wake, idle).is_err() {
                    attached = Default::default();
                    continue;
                }
                if let Some(now) = expiry.map(|_| Instant::now()) {
                    attached.iter_mut().flatten().for_each(|socket| socket.links.expire(now));
                }
            }
        }
    }
}

/// Busy polling for the rest of a partly received message. The rest often follows within
/// microseconds, which is faster than sleeping and waking.
#[derive(Default)]
struct Rest {
    /// The start of the current polling.
    since: Option<Instant>,
    /// The number of successful polls minus the number of failed ones.
    hit_score: i8,
}

impl Rest {
    const NEAR: Duration = Duration::from_micros(50);
    /// At this score, polling is only tried occasionally.
    const LEAST: i8 = -16;
    const MOST: i8 = 4;

    /// Records that frames arrived. `is_amid`: at least one message is still incomplete.
    fn on_frames(&mut self, is_amid: bool) {
        if self.since.take().is_some() {
            self.hit_score = (self.hit_score + 1).clamp(0, Self::MOST);
        }
        if is_amid && self.hit_score >= 0 {
            self.since = Some(Instant::now());
        } else if is_amid {
            self.hit_score += 1;
        }
    }

    /// Returns whether to poll again at once.
    fn is_near(&mut self) -> bool {
        let is_near = self.since.is_some_and(|since| since.elapsed() < Self::NEAR);
        if !is_near && self.since.take().is_some() {
            self.hit_score = if self.hit_score > 0 { self.hit_score - 1 } else { Self::LEAST };
        }
        is_near
    }
}

/// The receiving end of one of the node's links.
struct Socket {
    data: Arc<DataSocket>,
    /// Size of the largest frame, in bytes.
    largest: usize,
    links: Ingresses,
}

struct Subscriptions {
    send_path: Arc<SendPath>,
    feedback: Arc<Feedbacks>,
    receivers: HashMap<Name, Box<SubscriptionReceiver>>,
    /// Frames that arrived too early.
    early: EarlyFrames,
    /// Times at which subscriptions have work.
    timers: BTreeSet<(u64, Name)>,
    /// Subscriptions that received frames since they were last polled.
    touched: Vec<Name>,
    outgoing: OutgoingFeedback,
    /// Whether a recently received message is still incomplete.
    is_amid: bool,
}

impl Subscriptions {
    fn new(send_path: Arc<SendPath>, feedback: Arc<Feedbacks>) -> Self {
        Self {
            send_path,
            feedback,
            receivers: HashMap::new(),
            early: EarlyFrames::default(),
            timers: BTreeSet::new(),
            touched: Vec::new(),
            outgoing: OutgoingFeedback::default(),
            is_amid: false,
        }
    }

    fn remove(&mut self, name: &Name) {
        if let Some(at) = self.receivers.remove(name).and_then(|receiver| receiver.timer) {
            self.timers.remove(&(at, *name));
        }
    }

    fn change(&mut self, name: Name, changes: Vec<Change>) {
        let now = self.send_path.clock.now();
        for change in changes {
            let Some(receiver) = self.receivers.get_mut(&name) else { return };
            if let Some(writer) = receiver.change(now, change) {
                self.release(&name, &writer);
            }
        }
        self.poll(&name);
    }

    /// Processes the early frames of a writer again.
    fn release(&mut self, name: &Name, writer: &Name) {
        let now = self.send_path.clock.timestamps();
        let Some(receiver) = self.receivers.get_mut(name) else { return };
        for frame in self.early.release(name, writer) {
            match receiver.push(now, frame.source, &frame.payload, frame.marked, &self.send_path.counters) {
                Verdict::Done => {}
                Verdict::Early(reason, times) => self.early.keep_again(frame, (reason, times)),
            }
        }
    }

    fn take(&mut self, batch: &mut RecvBatch, links: &Ingresses) {
        let now = self.send_path.clock.timestamps();
        let counters = self.send_path.counters.clone();
        counters.frames_received.add(batch.len() as u64);
        for InFrame { bytes: frame, congested, .. } in batch.frames() {
            let Ok((ref header, rest)) = Header::read_from_prefix(frame) else {
                counters.refused[Counter::Truncated as usize].add(1);
                continue;
            };
            let link = links.of(header);
            let noticed = match forward::accept(header, frame.len(), &link.entry, &*link.window) {
                Ok(FrameType::Data) => None,
                Ok(other) => Some(link.notice(other, header, &counters, &self.feedback)),
                Err(counter) => Some(Err(counter)),
            };
            if let Some(noticed) = noticed {
                if let Err(counter) = noticed {
                    counters.refused[counter as usize].add(1);
                }
                continue;
            }
            link.count_data();
            let (name, source) = (header.destination, header.source);
            let payload = &rest[..header.payload_len().into()];
            let marked = congested || header.flags & ECN == CONGESTED;
            // Frames to this node's own name are feedback from counterparts, or segments of
            // requests and replies.
            if name == self.send_path.links.name() && payload.first() != Some(&SEGMENT_VERSION) {
                self.hear(source, payload, &counters);
                continue;
            }
            let Some(receiver) = self.receivers.get_mut(&name) else {
                counters.not_subscribed.add(1);
                continue;
            };
            let verdict = match receiver.knows(&source) {
                true => receiver.push(now, source, payload, marked, &counters),
                false => Verdict::Early(DropReason::UnknownWriter, 1),
            };
            if let Verdict::Early(reason, times) = verdict
                && !self.early.keep((name, source), payload, marked, (reason, times))
            {
                receiver.count_early(reason, times, &counters);
            }
            if !std::mem::replace(&mut receiver.is_touched, true) {
                self.touched.push(name);
            }
        }
    }

    /// Runs the due work of the subscriptions that have received frames.
    fn poll_touched(&mut self) {
        while let Some(name) = self.touched.pop() {
            self.poll(&name);
            if let Some(receiver) = self.receivers.get_mut(&name) {
                receiver.is_touched = false;
                self.is_amid |= receiver.is_amid();
            }
        }
    }

    /// Processes feedback from a counterpart, in a frame to this node's own name.
    fn hear(&mut self, source: Name, payload: &[u8], counters: &Counters) {
        let feedback = match self.send_path.pairs.open(&source, payload) {
            Some(Ok(feedback)) => feedback,
            None => return counters.feedback_unknown.add(1),
            Some(Err(PairError::Forged | PairError::Crypto(_))) => return counters.feedback_forged.add(1),
            Some(Err(PairError::Replayed)) => return counters.feedback_replayed.add(1),
            Some(Err(_)) => return counters.feedback_malformed.add(1),
        };
        counters.feedback_received.add(1);
        let session = PairOpener::session(payload).unwrap_or_default();
        feedback.iter().for_each(|feedback| self.apply(source, session, feedback));
    }

    /// Processes one message of feedback, of this session of the pair.
    fn apply(&mut self, source: Name, session: [u8; 8], feedback: &Feedback) {
        let (name, now) = (feedback.name(), self.send_path.clock.now());
        match feedback {
            Feedback::Hello { challenge, wants, .. } => {
                let publication = self.send_path.publications.get(&name);
                let welcome = publication.and_then(|it| it.welcome(&source, session, *challenge, *wants));
                if let Some(welcome) = welcome {
                    self.outgoing.push(&source, welcome);
                    self.send_path.upkeep.notify_one();
                }
            }
            Feedback::Report { .. } | Feedback::Nack { .. } => {
                if let Some(publication) = self.send_path.publications.get(&name) {
                    self.send_path.scheduler.feedback(now, publication.topic(), source, feedback);
                }
            }
            Feedback::Clock { session, challenge, unix_ns, .. } => {
                let publication = self.send_path.publications.get(&name);
                let answer = publication.and_then(|it| it.clock_answer(&source, *session, *challenge));
                if let Some(answer) = answer {
                    self.outgoing.push(&source, answer);
                    let ahead = ahead(*unix_ns, self.send_path.scheduler.stamp());
                    self.send_path.clocks.record(Instant::now(), source, ahead, true);
                }
            }
            Feedback::ClockAnswer { challenge, unix_ns, .. } => {
                let Some(receiver) = self.receivers.get_mut(&name) else { return };
                if let Some(ahead) = receiver.clock_answer(now, &source, challenge, *unix_ns) {
                    self.send_path.clocks.record(Instant::now(), source, ahead, false);
                }
                self.schedule(&name);
            }
            Feedback::NewestKey { key_box, .. } => {
                let publication = self.send_path.publications.get(&name);
                if publication.is_some_and(|it| it.sealer.take_newest(&source, key_box)) {
                    self.send_path.upkeep.notify_one();
                }
            }
            Feedback::Welcome { .. } | Feedback::Unavailable { .. } => {
                let Some(receiver) = self.receivers.get_mut(&name) else { return };
                if receiver.hear(now, &source, feedback) {
                    self.release(&name, &source);
                }
                self.poll(&name);
            }
        }
    }

    /// Runs a receiver's due work, and schedules its next wake-up.
    fn poll(&mut self, name: &Name) {
        let Some(receiver) = self.receivers.get_mut(name) else { return };
        let send_path = &self.send_path;
        let outgoing = &mut self.outgoing;
        receiver.poll(send_path.clock.now(), &send_path.counters, |writer, feedback| outgoing.push(writer, feedback));
        self.schedule(name);
    }

    /// Schedules the next wake-up of a receiver.
    fn schedule(&mut self, name: &Name) {
        let Some(receiver) = self.receivers.get_mut(name) else { return };
        let next = receiver.next_wake();
        let before = std::mem::replace(&mut receiver.timer, next);
        if before != next {
            before.map(|at| self.timers.remove(&(at, *name)));
            next.map(|at| self.timers.insert((at, *name)));
        }
    }

    /// Sends the feedback that is due. Reports that are due soon travel along.
    fn send_feedback(&mut self) {
        if self.outgoing.is_empty() {
            return;
        }
        let now = self.send_path.clock.now();
        let before = now + TOGETHER;
        let soon = self.timers.iter().take_while(|(at, _)| *at <= before).take(MOST_TOGETHER);
        for name in soon.map(|(_, name)| *name).collect::<Vec<_>>() {
            if let Some(receiver) = self.receivers.get_mut(&name) {
                receiver.report_early(now, before, &mut self.outgoing);
            }
            self.schedule(&name);
        }
        self.outgoing.flush(|writer, feedback| self.send_path.tell(writer, feedback));
    }

    fn tick(&mut self) {
        let now = self.send_path.clock.now();
        while let Some((_, name)) = self.timers.first().copied().filter(|(at, _)| *at <= now) {
            self.poll(&name);
        }
        while let Some((name, (reason, times))) = self.early.next_expired() {
            match self.receivers.get(&name) {
                Some(receiver) => receiver.count_early(reason, times, &self.send_path.counters),
                None => self.send_path.counters.dropped[reason as usize].add(times),
            }
        }
    }

    /// Returns the time until the next work is due. `other`: the time of work elsewhere.
    fn idle(&self, other: Option<Instant>) -> Duration {
        let timer = self.timers.first().map(|(at, _)| *at);
        let timer = timer.map(|at| Duration::from_nanos(at.saturating_sub(self.send_path.clock.now())));
        let expiries = [self.early.next_expiry(), other].into_iter().flatten();
        let expiries = expiries.map(|at| at.saturating_duration_since(Instant::now()));
        expiries.chain(timer).min().unwrap_or(LONGEST_SLEEP)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/receiver.rs"]
mod tests;
