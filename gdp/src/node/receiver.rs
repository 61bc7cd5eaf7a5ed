//! The thread that takes data frames from the socket to the subscriptions: hop tag, destination, reader, queue. It alone
//! owns the readers; others reach them by commands, which take effect before the next frame is looked at.

use std::collections::HashMap;
use std::sync::mpsc;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant, SystemTime};

use gdp_wire::replay::{self, Window};
use gdp_wire::{Counter, ErrorCode, FrameType, Header, LinkEntry, Name, forward};
use tokio::sync::mpsc as async_mpsc;
use zerocopy::FromBytes;

use super::counters::Counters;
use super::feedback::Feedbacks;
use super::held::Held;
use super::intake::{Intake, Writer};
use super::shared_entry::SharedEntry;
use super::supervisor::{Attachment, Event};
use crate::port::{DataSocket, RecvBatch};
use crate::seal::{DropReason, Moment};

/// How long the thread sleeps without a frame: messages that cannot complete any more are given up at this pace.
const TICK: Duration = Duration::from_millis(100);

/// How often the RIB is asked who writes a name, while frames come from sources that are not known to.
const ASK_AGAIN: Duration = Duration::from_millis(250);

/// What the rest of the node tells the thread.
pub enum Command {
    /// Frames now come on this link, which is new.
    Attach {
        attachment: Arc<Attachment>,
        /// A link that this one replaces, and until when the switch may still send on it.
        held: Option<(Arc<Attachment>, Instant)>,
    },
    Subscribe {
        name: Name,
        intake: Box<Intake>,
    },
    Unsubscribe {
        name: Name,
    },
    /// These writers of the name are verified; each until the given Unix time.
    Authorise {
        name: Name,
        writers: Vec<Writer>,
    },
    /// The node is closed: end, and with it all subscriptions.
    Stop,
}

pub struct Receiver {
    pub commands: mpsc::Receiver<Command>,
    pub events: async_mpsc::UnboundedSender<Event>,
    pub counters: Arc<Counters>,
    pub feedback: Arc<Feedbacks>,
}

impl Receiver {
    /// Runs until it is told to stop, or nobody can tell it any more.
    pub fn run(self) {
        let counters = &*self.counters;
        let mut intakes =
            Intakes { intakes: HashMap::new(), held: Held::default(), asked: HashMap::new(), start: Instant::now() };
        let mut attached: Option<(Arc<DataSocket>, usize, Links)> = None;
        let mut batch = None;
        let mut next_tick = Instant::now() + TICK;
        loop {
            loop {
                let command = match &attached {
                    Some(_) => self.commands.try_recv(),
                    None => self.commands.recv().map_err(|_| mpsc::TryRecvError::Disconnected),
                };
                match command {
                    Ok(Command::Attach { attachment, held }) => {
                        let earlier = attached.take().map(|(_, _, links)| links);
                        let held = held.map(|(silent, until)| (Ingress::of(&silent), until));
                        let links = Links::after(earlier, Ingress::of(&attachment), held);
                        attached = Some((attachment.data.clone(), attachment.largest, links));
                    }
                    Ok(Command::Subscribe { name, intake }) => drop(intakes.intakes.insert(name, intake)),
                    Ok(Command::Unsubscribe { name }) => drop(intakes.intakes.remove(&name)),
                    Ok(Command::Authorise { name, writers }) => intakes.authorise(&name, writers, counters),
                    Err(mpsc::TryRecvError::Empty) => break,
                    Ok(Command::Stop) | Err(mpsc::TryRecvError::Disconnected) => return,
                }
            }
            let Some((data, largest, links)) = &mut attached else { continue };
            let batch = batch.get_or_insert_with(|| RecvBatch::new(*largest));
            if batch.largest() < *largest {
                *batch = RecvBatch::new(*largest);
            }
            match data.try_recv_batch(batch) {
                Ok(0) => {
                    if data.wait_readable(TICK).is_err() {
                        attached = None;
                        continue;
                    }
                }
                Ok(_) => {
                    links.refresh();
                    intakes.take(batch, links, counters, &self.feedback, &self.events);
                }
                Err(error) => {
                    // The link is about to be lost as well; the next one brings its socket.
                    tracing::debug!(%error, "the data socket failed");
                    attached = None;
                    continue;
                }
            }
            if Instant::now() >= next_tick {
                next_tick = Instant::now() + TICK;
                links.held.retain(|(_, until)| Instant::now() < *until);
                intakes.tick(counters);
            }
        }
    }
}

/// The links that frames may come on.
struct Links {
    current: Ingress,
    /// Those that fell silent, and until when each is kept. A few: one is added each time the switch comes back.
    held: Vec<(Ingress, Instant)>,
}

impl Links {
    fn new(current: Ingress) -> Self {
        Self { current, held: Vec::new() }
    }

    /// A new link; `held` is the one that fell silent, which goes on as it was among `earlier` ones. The current one of these
    /// may be another, that never came into service.
    fn after(earlier: Option<Self>, new: Ingress, held: Option<(Ingress, Instant)>) -> Self {
        let mut links = Self::new(new);
        let Some((silent, until)) = held else { return links };
        let mut before = Vec::new();
        if let Some(earlier) = earlier {
            before = earlier.held;
            if earlier.current.entry.id == silent.entry.id {
                before.push((earlier.current, until));
            }
        }
        if before.iter().all(|(link, _)| link.entry.id != silent.entry.id) {
            before.push((silent, until));
        }
        links.held = before;
        links
    }

    /// Meets the keys that were put before; to be called after frames were received.
    fn refresh(&mut self) {
        let held = self.held.iter_mut().map(|(link, _)| link);
        held.chain([&mut self.current]).for_each(|link| link.entry = link.shared.get());
    }

    /// The link a frame says it is on; the current one for a frame that is on none, to be refused by it.
    fn of(&self, header: &Header) -> &Ingress {
        let held = self.held.iter().map(|(link, _)| link).find(|link| link.entry.id == header.link_id());
        held.unwrap_or(&self.current)
    }
}

/// A link that frames come from, and which of them came.
struct Ingress {
    shared: SharedEntry,
    /// As it is for the batch at hand.
    entry: LinkEntry,
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

struct Intakes {
    intakes: HashMap<Name, Box<Intake>>,
    /// Frames of sources that are being asked about.
    held: Held,
    /// When the writers of a subscribed name were last asked for.
    asked: HashMap<Name, Instant>,
    start: Instant,
}

impl Intakes {
    fn now(&self) -> Moment {
        let unix = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        Moment { steady_ns: self.start.elapsed().as_nanos() as u64, unix_ns: unix.as_nanos() as u64 }
    }

    fn authorise(&mut self, name: &Name, writers: Vec<Writer>, counters: &Counters) {
        let now = self.now();
        let Some(intake) = self.intakes.get_mut(name) else { return };
        writers.into_iter().for_each(|writer| intake.authorise(writer));
        for frame in self.held.release(name, |source| intake.knows(source)) {
            // Counted by the reader.
            let _ = intake.push(now, frame.source, &frame.payload, counters);
        }
        intake.count_drops(counters);
    }

    fn take(
        &mut self,
        batch: &mut RecvBatch,
        links: &Links,
        counters: &Counters,
        feedback: &Feedbacks,
        events: &async_mpsc::UnboundedSender<Event>,
    ) {
        let now = self.now();
        counters.frames_received.add(batch.len() as u64);
        let mut any_dropped = false;
        for (frame, _) in batch.frames() {
            let Ok((header, rest)) = Header::ref_from_prefix(frame) else {
                counters.refused[Counter::Truncated as usize].add(1);
                continue;
            };
            let link = links.of(header);
            let noticed = match forward::accept(header, frame.len(), &link.entry, &*link.window) {
                Ok(FrameType::Data) => None,
                Ok(other) => Some(link.notice(other, header, counters, feedback)),
                Err(counter) => Some(Err(counter)),
            };
            if let Some(noticed) = noticed {
                if let Err(counter) = noticed {
                    counters.refused[counter as usize].add(1);
                }
                continue;
            }
            let Some(intake) = self.intakes.get_mut(&header.destination) else {
                counters.not_subscribed.add(1);
                continue;
            };
            let payload = &rest[..header.payload_len().into()];
            if intake.knows(&header.source) {
                any_dropped |= intake.push(now, header.source, payload, counters).is_err();
                continue;
            }
            ask_about(&mut self.asked, header.destination, events);
            if !self.held.hold(header.destination, header.source, payload) {
                counters.dropped[DropReason::UnknownWriter as usize].add(1);
            }
        }
        if any_dropped {
            self.intakes.values_mut().for_each(|intake| intake.count_drops(counters));
        }
    }

    fn tick(&mut self, counters: &Counters) {
        let now = self.now();
        for intake in self.intakes.values_mut() {
            intake.expire(now);
            intake.count_drops(counters);
        }
        counters.dropped[DropReason::UnknownWriter as usize].add(self.held.expire());
        self.asked.retain(|_, when| when.elapsed() < ASK_AGAIN);
    }
}

/// Has the supervisor find out who writes `name`. The answer is about all its writers, so that no number of made-up sources
/// causes more than one question at a time.
fn ask_about(asked: &mut HashMap<Name, Instant>, name: Name, events: &async_mpsc::UnboundedSender<Event>) {
    let recently = asked.get(&name).is_some_and(|when| when.elapsed() < ASK_AGAIN);
    if !recently && events.send(Event::UnknownWriter { name }).is_ok() {
        asked.insert(name, Instant::now());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    use crate::crypto::Backend;
    use crate::port::LinkAddr;
    use crate::seal::{EpochKey, Limits, Reader};
    use zerocopy::IntoBytes;

    const NAME: Name = Name::from_bytes([1; 32]);
    const NODE: Name = Name::from_bytes([8; 32]);

    #[test]
    fn many_unknown_sources_cause_one_question() {
        let (name, mut intakes) = (NAME, subscribed());
        let (link, counters) = (links(), Counters::default());
        let (events, mut asked) = async_mpsc::unbounded_channel();
        let mut batch = RecvBatch::new(1500);
        for source in 0..50 {
            let mut header = Header::data(name, Name::from_bytes([source; 32]), 0);
            forward::stamp(&mut header, &link.current.entry, source.into());
            assert!(batch.push(header.as_bytes(), LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] }));
        }
        intakes.take(&mut batch, &link, &counters, &feedback(), &events);
        assert!(matches!(asked.try_recv(), Ok(Event::UnknownWriter { name: about }) if about == name));
        assert!(asked.try_recv().is_err());
        assert!(counters.snapshot(0).drops.is_empty(), "the frames wait for the answer");
    }

    #[test]
    fn a_frame_that_comes_again_on_its_link_is_refused() {
        let mut intakes = subscribed();
        let (shared, counters) = (SharedEntry::new(keyed(0)), Counters::default());
        let entry = shared.get();
        let (events, _asked) = async_mpsc::unbounded_channel();
        let mut take = |link: &Links, counts: &[u64]| {
            let mut batch = RecvBatch::new(1500);
            for count in counts {
                let mut header = Header::data(NAME, Name::from_bytes([9; 32]), 0);
                forward::stamp(&mut header, &entry, *count);
                assert!(batch.push(header.as_bytes(), LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] }));
            }
            intakes.take(&mut batch, link, &counters, &feedback(), &events);
            counters.refused[Counter::Replayed as usize].get()
        };
        let link = links();
        assert_eq!(take(&link, &[1, 3, 2, 1]), 1);
        assert_eq!(take(&link, &[4, 3, 2]), 3, "in another batch");
        assert_eq!(take(&links(), &[1, 2]), 3, "a new link counts anew");
    }

    #[test]
    fn errors_are_told_to_the_publisher_of_their_name_and_to_no_other() {
        let (counters, mut intakes, link) = (Counters::default(), subscribed(), links());
        let (events, _asked) = async_mpsc::unbounded_channel();
        let feedback = feedback();
        let (told, other) = (feedback.of(NAME), feedback.of(Name::from_bytes([3; 32])));
        let mut take = |count: u32, source: Name, code: u8| {
            let mut header = Header::data(NAME, source, 0);
            header.set_link_counter(1000 + count);
            header.become_error(ErrorCode::TooBig, 700);
            header.egress_set = code;
            forward::stamp(&mut header, &link.current.entry, count.into());
            let mut batch = RecvBatch::new(1500);
            assert!(batch.push(header.as_bytes(), LinkAddr::Ethernet { ifindex: 1, mac: [0; 6] }));
            intakes.take(&mut batch, &link, &counters, &feedback, &events);
        };
        take(1, NODE, ErrorCode::TooBig as u8);
        take(2, Name::from_bytes([9; 32]), ErrorCode::TooBig as u8);
        take(3, NODE, ErrorCode::NoRoute as u8);
        take(4, NODE, 0);
        take(5, NODE, ErrorCode::COUNT as u8 + 1);
        let errors = |too_big| BTreeMap::from([("no_route", 1), ("too_big", too_big)]);
        let counters = counters.snapshot(0);
        assert_eq!((counters.errors_received, told.errors()), (errors(2), errors(1)), "one was not about this node");
        assert_eq!(counters.drops, BTreeMap::from([("drop_unknown", 2)]), "codes that nobody knows");
        let last = told.last().unwrap();
        assert_eq!((last.code, last.mtu), (ErrorCode::NoRoute, None));
        assert_eq!(other.last(), None);
    }

    fn links() -> Links {
        Links::new(Ingress::new(SharedEntry::new(keyed(0)), Weak::new()))
    }

    /// A link whose two ends have the same keys.
    fn keyed(id: u32) -> LinkEntry {
        LinkEntry { id, peer_id: id, rx_keys: [[1, 2]; 2], tx_keys: [[1, 2]; 2], ..LinkEntry::default() }
    }

    fn feedback() -> Feedbacks {
        Feedbacks::new(NODE)
    }

    #[test]
    fn a_link_that_fell_silent_keeps_its_window_through_attempts_to_replace_it() {
        let entry = |id| SharedEntry::new(keyed(id));
        let link = |id| Ingress::new(entry(id), Weak::new());
        let until = Instant::now() + Duration::from_secs(60);
        let first = Links::new(link(1));
        assert!(replay::take(&*first.current.window, 7));
        let second = Links::after(Some(first), link(2), Some((link(1), until)));
        let third = Links::after(Some(second), link(3), Some((link(1), until)));
        let ids: Vec<u32> = third.held.iter().map(|(link, _)| link.entry.id).collect();
        assert_eq!((third.current.entry.id, ids), (3, vec![1]), "2 never came into service");
        assert!(!replay::is_fresh(&*third.held[0].0.window, 7));
    }

    fn subscribed() -> Intakes {
        let reader = Reader::new(NAME, Backend::default(), Limits::default());
        let key = EpochKey::from_bytes([2; 32]);
        let intake = Intake::new(reader, &key, async_mpsc::channel(1).0, Arc::default(), 1);
        Intakes {
            intakes: HashMap::from([(NAME, Box::new(intake))]),
            held: Held::default(),
            asked: HashMap::new(),
            start: Instant::now(),
        }
    }
}
