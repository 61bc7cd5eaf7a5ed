//! The thread that takes data frames from the socket to the subscriptions: hop tag, destination,
//! reader, queue; and what counterparts tell this node to those it concerns. It alone owns the
//! readers; others reach them by commands, which take effect before the next frame is looked at.

use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Weak, mpsc};
use std::time::{Duration, Instant};

use gdp_wire::replay::{self, Window};
use gdp_wire::{Counter, ErrorCode, FrameType, Header, Name, forward};
use zerocopy::FromBytes;

use super::attachment::Attachment;
use super::command::Command;
use super::counters::Counters;
use super::early_frames::EarlyFrames;
use super::feedback::Feedbacks;
use super::send_path::SendPath;
use super::shared_entry::SharedEntry;
use super::subscription_receiver::{Change, SubscriptionReceiver, Verdict};
use gdp_core::peer::MAX_LANES;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::keys::PairError;
use gdp_e2e::seal::{DropReason, SEGMENT_VERSION};
use gdp_link::link::KeyedEntry;
use gdp_link::port::{DataSocket, InFrame, RecvBatch};

/// How long the thread sleeps at most.
const TICK: Duration = Duration::from_millis(100);

/// The bits of [`Header::flags`] that tell of congestion, and what they are if it was met (RFC
/// 3168).
const ECN: u8 = 0b11;
const CONGESTED: u8 = 0b11;

pub struct Receiver {
    pub commands: mpsc::Receiver<Command>,
    pub send_path: Arc<SendPath>,
    pub feedback: Arc<Feedbacks>,
}

impl Receiver {
    /// Runs until it is told to stop, or nobody can tell it any more.
    pub fn run(self) {
        let mut subscriptions = Subscriptions::new(self.send_path, self.feedback);
        // By lane.
        let mut attached: [Option<Socket>; MAX_LANES] = Default::default();
        let mut batch = None;
        let mut next_tick = Instant::now() + TICK;
        let mut rest = Rest::default();
        loop {
            loop {
                let command = match attached.iter().any(Option::is_some) {
                    true => self.commands.try_recv(),
                    false => self.commands.recv_timeout(TICK).map_err(|error| match error {
                        mpsc::RecvTimeoutError::Timeout => mpsc::TryRecvError::Empty,
                        mpsc::RecvTimeoutError::Disconnected => mpsc::TryRecvError::Disconnected,
                    }),
                };
                match command {
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
            subscriptions.tick();
            let mut received = false;
            subscriptions.is_amid = false;
            for place in &mut attached {
                let Some(Socket { data, largest, links }) = place else { continue };
                let batch = batch.get_or_insert_with(|| RecvBatch::new(*largest));
                if batch.largest() < *largest {
                    *batch = RecvBatch::new(*largest);
                }
                match data.try_recv_batch(batch) {
                    Ok(0) => {}
                    Ok(_) => {
                        received = true;
                        links.refresh();
                        subscriptions.take(batch, links);
                    }
                    Err(error) => {
                        // The link is about to be lost as well; the next one brings its socket.
                        tracing::debug!(%error, "the data socket failed");
                        *place = None;
                    }
                }
            }
            if received {
                rest.on_frames(subscriptions.is_amid);
            } else if rest.is_near() {
                std::hint::spin_loop();
                continue;
            }
            let mut sockets = attached.iter().flatten().map(|socket| &*socket.data);
            if !received && sockets.clone().next().is_some() {
                let waited = match (sockets.next(), sockets.next()) {
                    (Some(only), None) => only.wait_readable(subscriptions.idle()).map(drop),
                    _ => DataSocket::wait_any(
                        attached.iter().flatten().map(|socket| &*socket.data),
                        subscriptions.idle(),
                    ),
                };
                if waited.is_err() {
                    attached = Default::default();
                    continue;
                }
            }
            if Instant::now() >= next_tick {
                next_tick = Instant::now() + TICK;
                let all = attached.iter_mut().flatten();
                all.for_each(|socket| socket.links.stale.retain(|(_, until)| Instant::now() < *until));
            }
        }
    }
}

/// The rest of a message, of which something has come: often it is but microseconds behind, and to
/// sleep and be woken would take longer.
#[derive(Default)]
struct Rest {
    /// Since when it is waited for.
    since: Option<Instant>,
    /// How often it came while it was waited for, less how often it did not.
    hit_score: i8,
}

impl Rest {
    const NEAR: Duration = Duration::from_micros(50);
    /// Who had none so often tries only now and then.
    const LEAST: i8 = -16;
    const MOST: i8 = 4;

    /// Frames came. `is_amid`: they did not end all messages.
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

    /// Whether to look again at once.
    fn is_near(&mut self) -> bool {
        let is_near = self.since.is_some_and(|since| since.elapsed() < Self::NEAR);
        if !is_near && self.since.take().is_some() {
            self.hit_score = if self.hit_score > 0 { self.hit_score - 1 } else { Self::LEAST };
        }
        is_near
    }
}

/// Where frames come in from one of the node's links.
struct Socket {
    data: Arc<DataSocket>,
    /// Bytes of the largest frame.
    largest: usize,
    links: Ingresses,
}

/// The links that frames may come on.
struct Ingresses {
    current: Ingress,
    /// Those that fell silent, and until when each is kept. A few: one is added each time the
    /// switch comes back.
    stale: Vec<(Ingress, Instant)>,
}

impl Ingresses {
    fn new(current: Ingress) -> Self {
        Self { current, stale: Vec::new() }
    }

    /// A new link; `stale` is the one that fell silent, which goes on as it was among `earlier`
    /// ones. The current one of these may be another, that never came into service.
    fn after(earlier: Option<Self>, new: Ingress, stale: Option<(Ingress, Instant)>) -> Self {
        let mut links = Self::new(new);
        let Some((silent, until)) = stale else { return links };
        let mut before = Vec::new();
        if let Some(earlier) = earlier {
            before = earlier.stale;
            if earlier.current.entry.id == silent.entry.id {
                before.push((earlier.current, until));
            }
        }
        if before.iter().all(|(link, _)| link.entry.id != silent.entry.id) {
            before.push((silent, until));
        }
        links.stale = before;
        links
    }

    /// Meets the keys that were put before; to be called after frames were received.
    fn refresh(&mut self) {
        let stale = self.stale.iter_mut().map(|(link, _)| link);
        stale.chain([&mut self.current]).for_each(|link| link.entry = link.shared.get());
    }

    /// The link a frame says it is on; the current one for a frame that is on none, to be refused
    /// by it.
    fn of(&self, header: &Header) -> &Ingress {
        let stale = self.stale.iter().map(|(link, _)| link).find(|link| link.entry.id == header.link_id());
        stale.unwrap_or(&self.current)
    }
}

/// A link that frames come from, and which of them came.
struct Ingress {
    shared: SharedEntry,
    /// As it is for the batch at hand.
    entry: KeyedEntry,
    window: Box<Window>,
    /// For answers, as long as the node sends on the link.
    attachment: Weak<Attachment>,
}

impl Ingress {
    fn new(shared: SharedEntry, attachment: Weak<Attachment>) -> Self {
        Self { entry: shared.get(), shared, window: Box::new(replay::empty()), attachment }
    }

    fn of(attachment: &Arc<Attachment>) -> Self {
        Self::new(attachment.entry.clone(), Arc::downgrade(attachment))
    }

    /// What the switch says to this node itself.
    fn notice(
        &self,
        frame_type: FrameType,
        header: &Header,
        counters: &Counters,
        feedback: &Feedbacks,
    ) -> Result<(), Counter> {
        match (frame_type, header.egress_set) {
            (FrameType::Error, code) => {
                let code = ErrorCode::from_number(code).ok_or(Counter::Unknown)?;
                counters.errors[code.index()].add(1);
                feedback.add(code, header);
                if let Some(attachment) = self.attachment.upgrade() {
                    attachment.frame_size.learn(code, header);
                }
            }
            (FrameType::Echo, Header::ASKS) => {
                if let Some(attachment) = self.attachment.upgrade() {
                    let mut answer = *header;
                    answer.become_answer();
                    attachment.send(answer);
                    counters.echoes_answered.add(1);
                }
            }
            (FrameType::Echo, Header::ANSWERS) => {
                if let Some(attachment) = self.attachment.upgrade() {
                    attachment.answered(header.egress_bits());
                }
            }
            _ => return Err(Counter::Unknown),
        }
        Ok(())
    }
}

struct Subscriptions {
    send_path: Arc<SendPath>,
    feedback: Arc<Feedbacks>,
    receivers: HashMap<Name, Box<SubscriptionReceiver>>,
    /// Frames that came too early.
    early: EarlyFrames,
    /// When subscriptions have something to do.
    timers: BTreeSet<(u64, Name)>,
    /// Subscriptions that something came for in the batch at hand.
    touched: Vec<Name>,
    /// Whether the rest of a message is to come, of which something came of late.
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

    /// Looks again at what came too early from a writer.
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
            let (name, source) = (header.destination, header.source);
            let payload = &rest[..header.payload_len().into()];
            let marked = congested || header.flags & ECN == CONGESTED;
            // What comes for this node's own name is what counterparts tell it, or segments:
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
            if self.touched.last() != Some(&name) && !self.touched.contains(&name) {
                self.touched.push(name);
            }
        }
        while let Some(name) = self.touched.pop() {
            self.poll(&name);
            self.is_amid |= self.receivers.get(&name).is_some_and(|receiver| receiver.is_amid());
        }
    }

    /// Takes a frame to this node's own name: what a counterpart tells it alone.
    fn hear(&mut self, source: Name, payload: &[u8], counters: &Counters) {
        let feedback = match self.send_path.pairs.open(&source, payload) {
            Some(Ok(feedback)) => feedback,
            None => return counters.feedback_unknown.add(1),
            Some(Err(PairError::Forged | PairError::Crypto(_))) => return counters.feedback_forged.add(1),
            Some(Err(PairError::Replayed)) => return counters.feedback_replayed.add(1),
            Some(Err(_)) => return counters.feedback_malformed.add(1),
        };
        counters.feedback_received.add(1);
        let (name, now) = (feedback.name(), self.send_path.clock.now());
        match &feedback {
            Feedback::Hello { challenge, wants, .. } => {
                let publication = self.send_path.publications.get(&name);
                let welcome = publication.and_then(|it| it.welcome(&source, *challenge, *wants));
                if let Some(welcome) = welcome {
                    self.send_path.tell(&source, &welcome);
                    self.send_path.upkeep.notify_one();
                }
            }
            Feedback::Report { .. } | Feedback::Nack { .. } => {
                if let Some(publication) = self.send_path.publications.get(&name) {
                    self.send_path.scheduler.feedback(now, publication.topic(), source, &feedback);
                }
            }
            Feedback::Welcome { .. } | Feedback::Unavailable { .. } => {
                let Some(receiver) = self.receivers.get_mut(&name) else { return };
                if receiver.hear(now, &source, &feedback) {
                    self.release(&name, &source);
                }
                self.poll(&name);
            }
        }
    }

    /// Has a receiver do what is due, and notes when it wants to be asked again.
    fn poll(&mut self, name: &Name) {
        let Some(receiver) = self.receivers.get_mut(name) else { return };
        let send_path = &self.send_path;
        receiver.poll(send_path.clock.now(), &send_path.counters, |writer, feedback| send_path.tell(writer, feedback));
        let next = receiver.next_wake();
        let before = std::mem::replace(&mut receiver.timer, next);
        if before != next {
            before.map(|at| self.timers.remove(&(at, *name)));
            next.map(|at| self.timers.insert((at, *name)));
        }
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

    /// How long nothing is due.
    fn idle(&self) -> Duration {
        let next = self.timers.first().map_or(u64::MAX, |(at, _)| *at);
        Duration::from_nanos(next.saturating_sub(self.send_path.clock.now())).min(TICK)
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/receiver.rs"]
mod tests;
