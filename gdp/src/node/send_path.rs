//! Everything that leaves the node: frames of the topics in their turn, and what it tells its
//! counterparts. Publishers send what may go at once themselves, so that a message on an idle link
//! is handed to no other thread; the sending thread does what has to wait. Frames are stamped when
//! they leave, never before.
//!
//! Of the node's links ([`LinkSlot`]) one is the main one: all topics are scheduled for it, and
//! move with it. What goes by two links is copied when its turn on the main one has come; copies
//! that wait for another link when that becomes the main one go by it still.
//!
//! Locks: each for a moment, none across an await. Who holds one of [`Publication`]'s may take
//! [`SendPath::uplink`] or [`SendPath::pairs`], never the other way round, and never both of these.
//! Who holds any lock may take [`SendPath::doubled`]. Who holds [`SendPath::sending`] may take any
//! of them, and those of a [`LinkSlot`]; publishers try, and never wait for it. Who holds
//! [`SendPath::choice`] may take those of a [`LinkSlot`] and [`SendPath::uplink`], and is called by
//! nobody who holds a lock.

use gdp_wire::hop;
use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use gdp_wire::{Header, Name};
use parking_lot::{Condvar, Mutex};
use tokio::sync::{Notify, watch};
use zerocopy::IntoBytes;

use super::choice::Choice;
use super::clock::Clock;
use super::counters::{Counters, NodeCounters};
use super::lane::{LinkSlot, LinkStatus, Status};
use super::message_batch::Turns;
use super::pairs::Pairs;
use super::publication::{Publication, Pushed};
use super::{LinkConfig, NodeError};
use crate::node::attachment::Attachment;
use gdp_core::identity::Identity;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::keys::PairError;
use gdp_e2e::transport::{Output, Topic, Transmit, Uplink, UplinkOptions};
use gdp_link::port::{BATCH, OutFrame, Sent};
use gdp_wire::SMALLEST_PATH;

/// Batches that a publisher sends itself; the rest of a large message is the sending thread's.
const OWN_BATCHES: usize = 4;

/// How long a request over another link than the main one may keep that waiting, and four round
/// trips.
const OTHERS_PATIENCE: Duration = Duration::from_secs(1);

/// Bits of [`Header::flags`]: the traffic class begins there, and the two lowest say that a mark is
/// understood (ECT(0), RFC 3168).
const CLASS_SHIFT: u8 = 2;
const UNDERSTANDS_MARKS: u8 = 0b10;

pub struct SendPath {
    pub clock: Clock,
    pub counters: Arc<Counters>,
    pub uplink: Mutex<Uplink>,
    pub pairs: Mutex<Pairs>,
    name: Name,
    /// In the order in which they are wanted.
    lanes: Vec<LinkSlot>,
    choice: Mutex<Choice>,
    ways: watch::Sender<SwitchLinks>,
    /// Names that go by two links, and what is told about them as well.
    doubled: Mutex<HashSet<Name>>,
    publications: Mutex<HashMap<Topic, Arc<Publication>>>,
    /// There may be key boxes for the RIB, or latched messages for a reader.
    pub upkeep: Notify,
    /// To sign.
    pub turns: Turns,
    pump: Mutex<Pump>,
    turn: Condvar,
    /// Held by whoever sends, so that frames go in the order in which they were taken from the
    /// uplink.
    sending: Mutex<Batch>,
}

/// The links to send by at the moment.
#[derive(Clone)]
pub struct SwitchLinks {
    /// The main one, and how it is; all of them, once the node is closed.
    pub main: usize,
    /// Rises each time another becomes that.
    pub turn: u64,
    pub status: Status,
    /// What copies go by.
    second: Option<(usize, Arc<Attachment>)>,
}

impl SwitchLinks {
    /// The links that frames go by, with their numbers.
    fn each(&self) -> impl Iterator<Item = (usize, &Arc<Attachment>)> {
        let main = self.status.attachment().map(|attachment| (self.main, attachment));
        main.into_iter().chain(self.second.as_ref().map(|(number, attachment)| (*number, attachment)))
    }

    fn is_one(&self, lane: usize) -> bool {
        self.each().any(|(number, _)| number == lane)
    }
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
    /// Topics whose small messages wait for others, and until when.
    gathering: BTreeSet<(u64, Topic)>,
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

impl SendPath {
    pub fn new(identity: &Identity, counters: Arc<Counters>, links: &[LinkConfig]) -> Self {
        let lanes: Vec<_> = links.iter().map(LinkSlot::new).collect();
        let budget = lanes.first().and_then(|lane| lane.budget);
        let ways = SwitchLinks { main: 0, turn: 0, status: Status::Down("connecting".into()), second: None };
        let (clock, max_payload) = (Clock::start(), usize::from(SMALLEST_PATH) - Header::LEN);
        let uplink = Uplink::new(clock.now(), UplinkOptions { max_payload, budget });
        Self {
            clock,
            counters,
            uplink: Mutex::new(uplink),
            pairs: Mutex::new(Pairs::new(identity.clone())),
            name: identity.name(),
            lanes,
            choice: Mutex::default(),
            ways: watch::Sender::new(ways),
            doubled: Mutex::default(),
            publications: Mutex::default(),
            upkeep: Notify::new(),
            turns: Turns::default(),
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
        let lanes = self.lanes.iter().map(|lane| lane.status());
        let socket_drops = lanes.filter_map(|status| Some(status.attachment()?.data.receive_drops())).sum();
        self.counters.snapshot(socket_drops)
    }

    pub fn lanes(&self) -> &[LinkSlot] {
        &self.lanes
    }

    pub fn lane(&self, attachment: &Attachment) -> &LinkSlot {
        &self.lanes[usize::from(attachment.lane)]
    }

    pub fn ways(&self) -> watch::Receiver<SwitchLinks> {
        self.ways.subscribe()
    }

    /// How each link is.
    pub fn links(&self) -> Vec<LinkStatus> {
        let main = self.ways.borrow().main;
        self.lanes.iter().enumerate().map(|(number, lane)| lane.snapshot(number == main)).collect()
    }

    /// A link is up, or is not any more.
    pub fn set_status(&self, lane: &LinkSlot, status: Status) {
        lane.set_silent(false);
        lane.set_moved(false);
        self.change_status(lane, |of_lane| *of_lane = status);
    }

    pub fn change_status(&self, lane: &LinkSlot, change: impl FnOnce(&mut Status)) {
        lane.change(change);
        self.choose(true);
    }

    /// Looks which links to send by. `changed`: how one of them is has changed.
    pub fn choose(&self, changed: bool) {
        let mut choice = self.choice.lock();
        let (now, before) = (self.clock.now(), choice.main());
        let fitness: Vec<_> = self.lanes.iter().map(LinkSlot::fitness).collect();
        if !choice.look(now, &fitness) && !changed {
            return;
        }
        let (main, second) = (choice.main(), choice.second());
        let (status, second_way) = (self.lanes[main].status(), self.second(second));
        self.ways.send_if_modified(|present| {
            if matches!(present.status, Status::Closed) {
                return false;
            }
            let turn = present.turn + u64::from(main != before);
            let before = std::mem::replace(present, SwitchLinks { main, turn, status, second: second_way });
            for (number, lane) in self.lanes.iter().enumerate() {
                if !(before.is_one(number) && present.is_one(number)) {
                    lane.drop_copies();
                }
            }
            true
        });
        if main != before {
            tracing::info!(from = before, to = main, "another link is the main one");
            self.uplink.lock().set_budget(self.lanes[main].budget);
            self.lanes[main].unstated.notify_one();
        }
        drop(choice);
        self.wake();
        if self.ways.borrow().status.attachment().is_none() {
            self.wake_publishers();
        }
    }

    /// Those that wait are to look whether there is sense in it.
    fn wake_publishers(&self) {
        self.publications.lock().values().for_each(|publication| publication.room.notify_waiters());
    }

    fn second(&self, lane: Option<usize>) -> Option<(usize, Arc<Attachment>)> {
        let lane = lane?;
        Some((lane, self.lanes[lane].status().attachment()?.clone()))
    }

    /// Nothing is sent any more.
    pub fn shut(&self) {
        self.ways.send_modify(|ways| (ways.status, ways.second) = (Status::Closed, None));
        for lane in &self.lanes {
            lane.change(|status| *status = Status::Closed);
            lane.drop_copies();
        }
        self.wake();
        self.wake_publishers();
    }

    /// Whether this goes by two links from now on.
    pub fn double(&self, name: Name, doubled: bool) {
        let mut names = self.doubled.lock();
        if doubled {
            names.insert(name)
        } else {
            names.remove(&name)
        };
    }

    /// Returns when the main link is not to wait for an answer on this one any more: at once if
    /// this one is silent.
    pub async fn until_unwanted(&self, attachment: &Attachment) {
        let (number, lane, mut ways) = (usize::from(attachment.lane), self.lane(attachment), self.ways());
        // The other end of the channel is this send_path's.
        let _ = ways.wait_for(|ways| ways.main != number && matches!(ways.status, Status::Up(_))).await;
        let patience = OTHERS_PATIENCE + 4 * attachment.link.rtt();
        let _ = tokio::time::timeout(patience, ways.wait_for(|_| lane.is_silent())).await;
    }

    /// Bytes of a payload that these links take: the main one, and if anything goes by two, each of
    /// them.
    fn max_payload(&self, ways: &SwitchLinks) -> Option<usize> {
        let main = ways.status.attachment()?.max_payload();
        let second = ways.second.as_ref().filter(|_| !self.doubled.lock().is_empty());
        Some(second.map_or(main, |(_, second)| main.min(second.max_payload())))
    }

    /// The main link, if it is up at this moment.
    pub fn attached_now(&self) -> Result<Arc<Attachment>, NodeError> {
        match &self.ways.borrow().status {
            Status::Up(attachment) => Ok(attachment.clone()),
            Status::Down(reason) | Status::Held(_, reason) => Err(NodeError::Detached(reason.clone())),
            Status::Closed => Err(NodeError::Closed),
        }
    }

    /// The link that frames go out on: the one that is up, or for a while the one that fell silent.
    pub fn sending_on(&self) -> Result<Arc<Attachment>, NodeError> {
        if let Status::Held(attachment, _) = &self.ways.borrow().status {
            return Ok(attachment.clone());
        }
        self.attached_now()
    }

    pub fn open(&self, publication: Arc<Publication>) {
        self.publications.lock().insert(publication.topic, publication);
    }

    pub fn close(&self, publication: &Publication) {
        self.publications.lock().remove(&publication.topic);
        publication.close(self);
    }

    /// Bytes that the frames of a topic's messages may carry.
    pub fn max_payload_of(&self, topic: Topic) -> usize {
        let of_link = self.max_payload(&self.ways.borrow());
        let now = self.clock.now();
        let mut uplink = self.uplink.lock();
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
            Some(mut batch) => self.drain(&mut batch, OWN_BATCHES),
            // Who sends at the moment may have looked already.
            None => Some(0),
        };
        self.plan(next);
    }

    /// Says something to a counterpart, if it is one and there is a link; if it is lost, so be it.
    pub fn tell(&self, peer: &Name, feedback: &Feedback) {
        let mut payload = Vec::new();
        match self.pairs.lock().seal(peer, feedback, &mut payload) {
            Some(Ok(())) => {}
            Some(Err(error)) => return tracing::warn!(%peer, %error, "feedback could not be sealed"),
            None => return,
        }
        let doubled = self.doubled.lock().contains(&feedback.name());
        if self.send_one(*peer, &payload, doubled) {
            self.counters.feedback_sent.add(1);
        }
    }

    /// What a counterpart says; `None` if it is none.
    pub fn hear(&self, peer: &Name, payload: &[u8]) -> Option<Result<Feedback, PairError>> {
        self.pairs.lock().open(peer, payload)
    }

    /// The sending thread has something to do at this time, if it does not know.
    pub fn plan(&self, at: Option<u64>) {
        let Some(at) = at else { return };
        let mut pump = self.pump.lock();
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
        self.pump.lock().gathering.insert((until, topic));
        self.plan(Some(until));
    }

    /// Something changed that the sending thread is to look at.
    pub fn wake(&self) {
        self.plan(Some(0));
    }

    /// After feedback: what it made room for goes.
    pub fn settle(&self) {
        let next = self.uplink.lock().next_wake();
        self.plan(next);
    }

    /// Ends [`Self::pump`].
    pub fn stop(&self) {
        self.pump.lock().stop = true;
        self.turn.notify_one();
    }

    /// The sending thread: runs until it is stopped.
    pub fn pump(&self) {
        loop {
            let next = self.drain(&mut self.sending.lock(), usize::MAX);
            let mut pump = self.pump.lock();
            if pump.stop {
                return;
            }
            let chores = std::mem::take(&mut pump.chores);
            let gathered = pump.gathering.first().map_or(u64::MAX, |(until, _)| *until);
            let until = next.unwrap_or(u64::MAX).min(gathered);
            if chores.is_empty() && !pump.again && until > self.clock.now() {
                pump.asleep = Some(until);
                let time = Duration::from_nanos(until.saturating_sub(self.clock.now()));
                self.turn.wait_while_for(&mut pump, |pump| !pump.again && !pump.stop, time);
                pump.asleep = None;
            }
            pump.again = false;
            let now = self.clock.now();
            let mut due = Vec::new();
            while let Some((_, topic)) = pump.gathering.first().copied().filter(|(until, _)| *until <= now) {
                pump.gathering.pop_first();
                due.push(topic);
            }
            drop(pump);
            due.into_iter().for_each(|topic| self.seal_batch(topic, now));
            chores.into_iter().for_each(|chore| self.run_maintenance(chore));
        }
    }

    /// Sends what may go now, so many batches of it. Returns when there is more; what is not a
    /// frame is a chore of the sending thread.
    fn drain(&self, batch: &mut Batch, batches: usize) -> Option<u64> {
        let ways = self.ways.borrow().clone();
        let (attachment, max_payload) = (ways.status.attachment()?, self.max_payload(&ways)?);
        for _ in 0..batches {
            let (mut next, mut chores, mut rooms) = (Some(0), Vec::new(), Vec::new());
            let mut uplink = self.uplink.lock();
            let now = self.clock.now();
            if uplink.max_payload() != max_payload {
                uplink.set_max_payload(now, max_payload);
            }
            while batch.transmits.len() < BATCH {
                match uplink.poll(now) {
                    Some(Output::Send(transmit)) => batch.transmits.push(transmit),
                    // Publishers are to be ready again before all that goes now has gone.
                    Some(room @ Output::Room { .. }) => rooms.push(room),
                    Some(chore) => chores.push(chore),
                    None => {
                        next = uplink.next_wake();
                        break;
                    }
                }
            }
            drop(uplink);
            rooms.into_iter().for_each(|room| self.run_maintenance(room));
            if let Some((second, attachment)) = &ways.second {
                self.lanes[*second].copy(now, &batch.transmits, attachment.max_payload());
            }
            self.send_frames(attachment, batch);
            for (number, attachment) in ways.each() {
                let copies = self.lanes[number].take_copies(now, &mut batch.transmits, BATCH);
                self.send_frames(attachment, batch);
                next = next.into_iter().chain(copies).min();
            }
            if !chores.is_empty() {
                let mut pump = self.pump.lock();
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
            hop::stamp(header, &entry, attachment.next_count());
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
        self.count(attachment, sent);
        transmits.clear();
    }

    /// Sends a frame by the main link, or by two; whether there is any.
    pub(super) fn send_one(&self, to: Name, payload: &[u8], doubled: bool) -> bool {
        let SwitchLinks { status, second, .. } = self.ways.borrow().clone();
        let second = second.filter(|_| doubled).map(|(_, second)| second);
        let mut sent = false;
        for attachment in status.attachment().into_iter().chain(&second) {
            self.send_one_on(attachment, to, payload);
            sent = true;
        }
        sent
    }

    pub(super) fn send_one_on(&self, attachment: &Attachment, to: Name, payload: &[u8]) {
        let mut header = Header::data(to, self.name, payload.len() as u16);
        hop::stamp(&mut header, &attachment.entry.get(), attachment.next_count());
        let frame = OutFrame { to: attachment.link.addr(), head: header.as_bytes(), body: payload };
        let sent = attachment.data.send_batch([frame]);
        self.count(attachment, sent);
    }

    fn count(&self, attachment: &Attachment, sent: Sent) {
        let lane = self.lane(attachment);
        for (count, more) in [
            (&self.counters.frames_sent, sent.sent),
            (&lane.frames_sent, sent.sent),
            (&self.counters.frames_unsent, sent.lost),
            (&lane.frames_unsent, sent.lost),
        ] {
            count.add(more as u64);
        }
    }

    fn seal_batch(&self, topic: Topic, due: u64) {
        let Some(publication) = self.publications.lock().get(&topic).cloned() else { return };
        if let Err(error) = publication.seal_batch(self, due) {
            tracing::warn!(name = %publication.name, %error, "messages are lost that waited for others");
        }
    }

    fn run_maintenance(&self, chore: Output) {
        let of = |topic: &Topic| self.publications.lock().get(topic).cloned();
        match chore {
            Output::Send(_) => unreachable!("frames are sent where they are found"),
            Output::Reseal { topic, message } => {
                let Some(publication) = of(&topic) else { return };
                let recut = publication.recut(&message, self.max_payload_of(topic));
                let mut uplink = self.uplink.lock();
                match recut {
                    Some(smaller) => uplink.resealed(self.clock.now(), topic, smaller),
                    None => uplink.abandon(self.clock.now(), topic, &message),
                }
            }
            Output::Heartbeat { topic, next, oldest } => {
                let Some(publication) = of(&topic) else { return };
                let (mut payload, doubled) = (Vec::new(), self.doubled.lock().contains(&publication.name));
                match publication.heartbeat(next, oldest, &mut payload) {
                    Ok(()) => _ = self.send_one(publication.name, &payload, doubled),
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
