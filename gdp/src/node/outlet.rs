//! Everything that leaves the node: frames of the topics in their turn, and what it tells its counterparts. Publishers send what
//! may go at once themselves, so that a message on an idle link is handed to no other thread; the sending thread does what has to
//! wait. Frames are stamped when they leave, never before.
//!
//! Locks: each for a moment, none across an await. Who holds one of [`Publication`]'s may take [`Outlet::uplink`] or [`Outlet::pairs`],
//! never the other way round, and never both of these. Who holds [`Outlet::sending`] may take any of them; publishers try, and never
//! wait for it.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::Duration;

use gdp_wire::{Header, Name, forward};
use tokio::sync::{Notify, watch};
use zerocopy::IntoBytes;

use super::NodeError;
use super::clock::Clock;
use super::counters::{Counters, NodeCounters};
use super::pairs::Pairs;
use super::publication::{Publication, Pushed};
use super::state::lock;
use super::supervisor::Attachment;
use crate::feedback_wire::Feedback;
use crate::identity::Identity;
use crate::keys::PairError;
use crate::port::{BATCH, OutFrame, SMALLEST_PATH};
use crate::transport::{Output, Topic, Transmit, Uplink, UplinkOptions};

/// Batches that a publisher sends itself; the rest of a large message is the sending thread's.
const OWN_BATCHES: usize = 4;

/// Bits of [`Header::flags`]: the traffic class begins there, and the two lowest say that a mark is understood (ECT(0), RFC 3168).
const CLASS_SHIFT: u8 = 2;
const UNDERSTANDS_MARKS: u8 = 0b10;

pub struct Outlet {
    pub clock: Clock,
    pub counters: Arc<Counters>,
    pub uplink: Mutex<Uplink>,
    pub pairs: Mutex<Pairs>,
    name: Name,
    status: watch::Sender<Status>,
    publications: Mutex<HashMap<Topic, Arc<Publication>>>,
    /// There may be key boxes for the RIB, or latched messages for a reader.
    pub upkeep: Notify,
    pump: Mutex<Pump>,
    turn: Condvar,
    /// Held by whoever sends, so that frames go in the order in which they were taken from the uplink.
    sending: Mutex<Batch>,
}

#[derive(Clone)]
pub enum Status {
    Down(String),
    /// The switch fell silent, for this reason. Its kernel may forward on, so frames still go out on the link; nothing can
    /// be asked over it.
    Held(Arc<Attachment>, String),
    Up(Arc<Attachment>),
    Closed,
}

/// What the sending thread is to do, and when.
#[derive(Default)]
struct Pump {
    /// It sleeps, until then at the latest.
    asleep: Option<u64>,
    again: bool,
    stop: bool,
    /// What others found to do while they sent.
    chores: Vec<Output>,
    /// Topics whose small messages wait for others, and until when: in the order of time.
    gathering: VecDeque<(u64, Topic)>,
}

/// Room for the frames of one batch, kept from one to the next.
struct Batch {
    transmits: Vec<Transmit>,
    headers: Box<[Header; BATCH]>,
    /// Payloads that are put together from several.
    joined: Vec<u8>,
}

impl Batch {
    fn new() -> Self {
        Self { transmits: Vec::with_capacity(BATCH), headers: Box::new([Header::default(); BATCH]), joined: Vec::new() }
    }
}

impl Outlet {
    pub fn new(identity: &Identity, counters: Arc<Counters>, budget: Option<u64>) -> Self {
        let (clock, max_payload) = (Clock::start(), usize::from(SMALLEST_PATH) - Header::LEN);
        let uplink = Uplink::new(clock.now(), UplinkOptions { max_payload, budget });
        Self {
            clock,
            counters,
            uplink: Mutex::new(uplink),
            pairs: Mutex::new(Pairs::new(identity.clone())),
            name: identity.name(),
            status: watch::Sender::new(Status::Down("connecting".into())),
            publications: Mutex::default(),
            upkeep: Notify::new(),
            pump: Mutex::default(),
            turn: Condvar::new(),
            sending: Mutex::new(Batch::new()),
        }
    }

    /// This node's own.
    pub fn name(&self) -> Name {
        self.name
    }

    pub fn node_counters(&self) -> NodeCounters {
        let socket_drops = self.sending_on().map_or(0, |attachment| attachment.data.receive_drops());
        self.counters.snapshot(socket_drops)
    }

    pub fn status(&self) -> watch::Receiver<Status> {
        self.status.subscribe()
    }

    pub fn set_status(&self, status: Status) {
        let closed = matches!(status, Status::Closed);
        self.status.send_replace(status);
        self.wake();
        if closed {
            lock(&self.publications).values().for_each(|publication| publication.room.notify_waiters());
        }
    }

    pub fn change_status(&self, change: impl FnOnce(&mut Status)) {
        self.status.send_modify(change);
    }

    /// The link, if it is up at this moment.
    pub fn attached_now(&self) -> Result<Arc<Attachment>, NodeError> {
        match &*self.status.borrow() {
            Status::Up(attachment) => Ok(attachment.clone()),
            Status::Down(reason) | Status::Held(_, reason) => Err(NodeError::Detached(reason.clone())),
            Status::Closed => Err(NodeError::Closed),
        }
    }

    /// The link that frames go out on: the one that is up, or for a while the one that fell silent.
    pub fn sending_on(&self) -> Result<Arc<Attachment>, NodeError> {
        if let Status::Held(attachment, _) = &*self.status.borrow() {
            return Ok(attachment.clone());
        }
        self.attached_now()
    }

    pub fn open(&self, publication: Arc<Publication>) {
        lock(&self.publications).insert(publication.topic, publication);
    }

    pub fn close(&self, publication: &Publication) {
        lock(&self.publications).remove(&publication.topic);
        publication.close(self);
    }

    /// Bytes that the frames of a topic's messages may carry.
    pub fn max_payload_of(&self, topic: Topic) -> usize {
        let of_link = self.sending_on().ok().map(|attachment| attachment.max_payload());
        let now = self.clock.now();
        let mut uplink = lock(&self.uplink);
        if let Some(of_link) = of_link
            && of_link != uplink.max_payload()
        {
            uplink.set_max_payload(now, of_link);
        }
        uplink.max_payload_of(now, topic)
    }

    /// Sends what may go now, and leaves the rest to the sending thread.
    pub fn send(&self) {
        let next = match self.sending.try_lock() {
            Ok(mut batch) => self.drain(&mut batch, OWN_BATCHES),
            // Who sends at the moment may have looked already.
            Err(_) => Some(0),
        };
        self.plan(next);
    }

    /// Says something to a counterpart, if it is one and there is a link; if it is lost, so be it.
    pub fn tell(&self, peer: &Name, feedback: &Feedback) {
        let Ok(attachment) = self.sending_on() else { return };
        let mut payload = Vec::new();
        match lock(&self.pairs).seal(peer, feedback, &mut payload) {
            Some(Ok(())) => {}
            Some(Err(error)) => return tracing::warn!(%peer, %error, "feedback could not be sealed"),
            None => return,
        }
        self.send_one(&attachment, *peer, &payload);
        self.counters.feedback_sent.add(1);
    }

    /// What a counterpart says; `None` if it is none.
    pub fn hear(&self, peer: &Name, payload: &[u8]) -> Option<Result<Feedback, PairError>> {
        lock(&self.pairs).open(peer, payload)
    }

    /// The sending thread has something to do at this time, if it does not know.
    pub fn plan(&self, at: Option<u64>) {
        let Some(at) = at else { return };
        let mut pump = lock(&self.pump);
        match pump.asleep {
            Some(until) if until <= at => {}
            Some(_) => {
                pump.again = true;
                self.turn.notify_one();
            }
            None => pump.again = true,
        }
    }

    /// Seals at this time what a topic has gathered.
    pub fn gather(&self, topic: Topic, until: u64) {
        lock(&self.pump).gathering.push_back((until, topic));
        self.plan(Some(until));
    }

    /// Something changed that the sending thread is to look at.
    pub fn wake(&self) {
        self.plan(Some(0));
    }

    /// After feedback: what it made room for goes.
    pub fn settle(&self) {
        let next = lock(&self.uplink).next_wake();
        self.plan(next);
    }

    /// Ends [`Self::pump`].
    pub fn stop(&self) {
        lock(&self.pump).stop = true;
        self.turn.notify_one();
    }

    /// The sending thread: runs until it is stopped.
    pub fn pump(&self) {
        loop {
            let next = self.drain(&mut lock(&self.sending), usize::MAX);
            let mut pump = lock(&self.pump);
            if pump.stop {
                return;
            }
            let chores = std::mem::take(&mut pump.chores);
            let gathered = pump.gathering.front().map_or(u64::MAX, |(until, _)| *until);
            let until = next.unwrap_or(u64::MAX).min(gathered);
            if chores.is_empty() && !pump.again && until > self.clock.now() {
                pump.asleep = Some(until);
                let time = Duration::from_nanos(until.saturating_sub(self.clock.now()));
                let waited = self.turn.wait_timeout_while(pump, time, |pump| !pump.again && !pump.stop);
                pump = waited.unwrap_or_else(PoisonError::into_inner).0;
                pump.asleep = None;
            }
            pump.again = false;
            let now = self.clock.now();
            let due = pump.gathering.partition_point(|(until, _)| *until <= now);
            let due: Vec<Topic> = pump.gathering.drain(..due).map(|(_, topic)| topic).collect();
            drop(pump);
            due.into_iter().for_each(|topic| self.seal_gathered(topic, now));
            chores.into_iter().for_each(|chore| self.do_chore(chore));
        }
    }

    /// Sends what may go now, so many batches of it. Returns when there is more; what is not a frame is a chore of the sending
    /// thread.
    fn drain(&self, batch: &mut Batch, batches: usize) -> Option<u64> {
        let attachment = self.sending_on().ok()?;
        let max_payload = attachment.max_payload();
        for _ in 0..batches {
            let (mut next, mut chores) = (Some(0), Vec::new());
            let mut uplink = lock(&self.uplink);
            let now = self.clock.now();
            if uplink.max_payload() != max_payload {
                uplink.set_max_payload(now, max_payload);
            }
            while batch.transmits.len() < BATCH {
                match uplink.poll(now) {
                    Some(Output::Send(transmit)) => batch.transmits.push(transmit),
                    Some(chore) => chores.push(chore),
                    None => {
                        next = uplink.next_wake();
                        break;
                    }
                }
            }
            drop(uplink);
            self.send_frames(&attachment, batch);
            if !chores.is_empty() {
                let mut pump = lock(&self.pump);
                pump.chores.append(&mut chores);
                drop(pump);
                self.wake();
            }
            if next != Some(0) {
                return next;
            }
        }
        Some(0)
    }

    fn send_frames(&self, attachment: &Attachment, batch: &mut Batch) {
        let Batch { transmits, headers, joined } = batch;
        if transmits.is_empty() {
            return;
        }
        let entry = attachment.entry.get();
        joined.clear();
        for (header, transmit) in headers.iter_mut().zip(&*transmits) {
            // Payloads are within the link's MTU, which 16 bits can express.
            *header = Header::data(transmit.name, self.name, transmit.payload_len() as u16);
            header.flags |= transmit.class << CLASS_SHIFT | UNDERSTANDS_MARKS;
            forward::stamp(header, &entry, attachment.next_count());
            if transmit.payloads().nth(1).is_some() {
                transmit.payloads().for_each(|payload| joined.extend_from_slice(payload));
            }
        }
        let (to, mut rest) = (attachment.link.addr(), &joined[..]);
        let frames = headers.iter().zip(&*transmits).map(|(header, transmit)| {
            let mut payloads = transmit.payloads();
            let body = match (payloads.next(), payloads.next()) {
                (Some(only), None) => only,
                _ => {
                    let (body, behind) = rest.split_at(transmit.payload_len());
                    rest = behind;
                    body
                }
            };
            OutFrame { to, head: header.as_bytes(), body }
        });
        let sent = attachment.data.send_batch(frames);
        self.counters.frames_sent.add(sent.sent as u64);
        self.counters.frames_unsent.add(sent.lost as u64);
        transmits.clear();
    }

    pub(super) fn send_one(&self, attachment: &Attachment, to: Name, payload: &[u8]) {
        let mut header = Header::data(to, self.name, payload.len() as u16);
        forward::stamp(&mut header, &attachment.entry.get(), attachment.next_count());
        let frame = OutFrame { to: attachment.link.addr(), head: header.as_bytes(), body: payload };
        let sent = attachment.data.send_batch([frame]);
        self.counters.frames_sent.add(sent.sent as u64);
        self.counters.frames_unsent.add(sent.lost as u64);
    }

    fn seal_gathered(&self, topic: Topic, due: u64) {
        let Some(publication) = lock(&self.publications).get(&topic).cloned() else { return };
        if let Err(error) = publication.seal_gathered(self, due) {
            tracing::warn!(name = %publication.name, %error, "messages are lost that waited for others");
        }
    }

    fn do_chore(&self, chore: Output) {
        let of = |topic: &Topic| lock(&self.publications).get(topic).cloned();
        match chore {
            Output::Send(_) => unreachable!("frames are sent where they are found"),
            Output::Reseal { topic, message } => {
                let Some(publication) = of(&topic) else { return };
                let recut = publication.recut(&message, self.max_payload_of(topic));
                let mut uplink = lock(&self.uplink);
                match recut {
                    Some(smaller) => uplink.resealed(self.clock.now(), topic, smaller),
                    None => uplink.abandon(self.clock.now(), topic, &message),
                }
            }
            Output::Heartbeat { topic, next, oldest } => {
                let (Some(publication), Ok(attachment)) = (of(&topic), self.sending_on()) else { return };
                let mut payload = Vec::new();
                match publication.heartbeat(next, oldest, &mut payload) {
                    Ok(()) => self.send_one(&attachment, publication.name, &payload),
                    Err(error) => tracing::warn!(name = %publication.name, %error, "a heartbeat could not be sealed"),
                }
            }
            Output::Gone { topic, reader, oldest } => {
                let Some(publication) = of(&topic) else { return };
                let (name, session) = (publication.name, publication.session);
                self.tell(&reader, &Feedback::Gone { name, session, oldest });
            }
            Output::Room { topic } => {
                let Some(publication) = of(&topic) else { return };
                // What waits goes, also if who wanted it sent does not wait any more.
                if !matches!(publication.push_waiting(self), Ok(Pushed::Waits)) {
                    publication.room.notify_waiters();
                }
            }
        }
    }
}
