//! The thread that takes data frames from the socket to the subscriptions: hop tag, destination, reader, queue. It alone
//! owns the readers; others reach them by commands, which take effect before the next frame is looked at.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant, SystemTime};

use gdp_wire::{Header, LinkEntry, Name, forward};
use tokio::sync::mpsc as async_mpsc;
use zerocopy::FromBytes;

use super::counters::Counters;
use super::supervisor::Event;
use crate::identity::VerifyKey;
use crate::port::{DataSocket, RecvBatch};
use crate::seal::{DropReason, Message, Reader};

/// How long the thread sleeps without a frame: messages that cannot complete any more are given up at this pace.
const TICK: Duration = Duration::from_millis(100);

/// How often the same unknown source is asked about, and how many are remembered.
const ASK_AGAIN: Duration = Duration::from_secs(1);
const MAX_ASKED: usize = 256;

/// Writers of one name that are believed at once.
const MAX_WRITERS: usize = 256;

/// What the rest of the node tells the thread.
pub enum Command {
    /// Frames now come from this socket, on this link.
    Attach {
        data: Arc<DataSocket>,
        entry: LinkEntry,
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

/// A writer whose right to a name was verified.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Writer {
    pub entity: Name,
    pub key: VerifyKey,
    pub not_after: u64,
}

/// The thread's side of a subscription.
pub struct Intake {
    pub reader: Reader,
    pub queue: async_mpsc::Sender<Message>,
    pub queued_bytes: Arc<AtomicUsize>,
    pub max_queued_bytes: usize,
    /// What a writer signed this long before it became known here is taken for a recording.
    pub max_age: Duration,
    writers: HashMap<Name, u64>,
    seen_drops: [u64; DropReason::COUNT],
}

impl Intake {
    pub fn new(
        reader: Reader,
        queue: async_mpsc::Sender<Message>,
        queued_bytes: Arc<AtomicUsize>,
        max_queued_bytes: usize,
        max_age: Duration,
    ) -> Self {
        Self {
            reader,
            queue,
            queued_bytes,
            max_queued_bytes,
            max_age,
            writers: HashMap::new(),
            seen_drops: [0; DropReason::COUNT],
        }
    }

    fn authorise(&mut self, writer: Writer) {
        if self.writers.len() >= MAX_WRITERS && !self.writers.contains_key(&writer.entity) {
            tracing::warn!(writer = %writer.entity, "more than {MAX_WRITERS} writers of one name; this one is not believed");
            return;
        }
        if self.reader.authorise(writer.entity, writer.key).is_err() {
            return;
        }
        // A writer that comes back keeps the floor and the replay windows it had.
        if self.writers.insert(writer.entity, writer.not_after).is_none() {
            let floor = unix_time().saturating_sub(self.max_age);
            self.reader.refuse_before(&writer.entity, floor.as_nanos() as u64);
        }
    }

    /// A writer is believed as long as its certificate holds, not as long as it is attached: forgetting it would forget
    /// which of its messages were delivered.
    fn expire(&mut self, now: u64) {
        let unix = unix_time().as_secs();
        let reader = &mut self.reader;
        self.writers.retain(|writer, not_after| {
            let holds = unix <= *not_after;
            if !holds {
                reader.revoke(writer);
            }
            holds
        });
        if reader.next_deadline().is_some_and(|deadline| deadline < now) {
            reader.expire(now);
        }
    }

    fn count_drops(&mut self, counters: &Counters) {
        let drops = self.reader.drops();
        if *drops != self.seen_drops {
            for ((now, seen), count) in drops.iter().zip(&self.seen_drops).zip(&counters.dropped) {
                count.add(now - seen);
            }
            self.seen_drops = *drops;
        }
    }

    fn deliver(&mut self, message: Message, counters: &Counters) {
        let length = message.body.len();
        let queued = self.queued_bytes.fetch_add(length, Ordering::Relaxed);
        match self.queue.try_reserve() {
            Ok(place) if queued.saturating_add(length) <= self.max_queued_bytes => {
                // Counted first: who has the message may look.
                counters.messages_received.add(1);
                place.send(message);
            }
            _ => {
                self.queued_bytes.fetch_sub(length, Ordering::Relaxed);
                counters.queue_full.add(1);
            }
        }
    }
}

pub struct Receiver {
    pub commands: mpsc::Receiver<Command>,
    pub events: async_mpsc::UnboundedSender<Event>,
    pub counters: Arc<Counters>,
}

impl Receiver {
    /// Runs until it is told to stop, or nobody can tell it any more.
    pub fn run(self) {
        let mut state =
            Intakes { intakes: HashMap::new(), asked: HashMap::new(), messages: Vec::new(), start: Instant::now() };
        let mut attached: Option<(Arc<DataSocket>, LinkEntry)> = None;
        let mut batch = None;
        let mut next_tick = Instant::now() + TICK;
        loop {
            loop {
                let command = match &attached {
                    Some(_) => self.commands.try_recv(),
                    None => self.commands.recv().map_err(|_| mpsc::TryRecvError::Disconnected),
                };
                match command {
                    Ok(Command::Attach { data, entry }) => attached = Some((data, entry)),
                    Ok(Command::Subscribe { name, intake }) => drop(state.intakes.insert(name, intake)),
                    Ok(Command::Unsubscribe { name }) => drop(state.intakes.remove(&name)),
                    Ok(Command::Authorise { name, writers }) => state.authorise(&name, writers),
                    Err(mpsc::TryRecvError::Empty) => break,
                    Ok(Command::Stop) | Err(mpsc::TryRecvError::Disconnected) => return,
                }
            }
            let Some((data, entry)) = &attached else { continue };
            // The largest frame the link may carry, or the socket would not be able to tell that one is too large.
            let batch = batch.get_or_insert_with(|| RecvBatch::new(entry.mtu as usize));
            if batch.largest() < entry.mtu as usize {
                *batch = RecvBatch::new(entry.mtu as usize);
            }
            match data.try_recv_batch(batch) {
                Ok(0) => {
                    if data.wait_readable(TICK).is_err() {
                        attached = None;
                        continue;
                    }
                }
                Ok(_) => state.take(batch, entry, &self.counters, &self.events),
                Err(error) => {
                    // The link is about to be lost as well; the next one brings its socket.
                    tracing::debug!(%error, "the data socket failed");
                    attached = None;
                    continue;
                }
            }
            if Instant::now() >= next_tick {
                next_tick = Instant::now() + TICK;
                state.tick(&self.counters);
            }
        }
    }
}

struct Intakes {
    intakes: HashMap<Name, Box<Intake>>,
    /// Unknown sources, and when they were last asked about.
    asked: HashMap<(Name, Name), Instant>,
    messages: Vec<Message>,
    start: Instant,
}

impl Intakes {
    fn authorise(&mut self, name: &Name, writers: Vec<Writer>) {
        if let Some(intake) = self.intakes.get_mut(name) {
            writers.into_iter().for_each(|writer| intake.authorise(writer));
        }
    }

    fn take(
        &mut self,
        batch: &mut RecvBatch,
        link: &LinkEntry,
        counters: &Counters,
        events: &async_mpsc::UnboundedSender<Event>,
    ) {
        let now = self.start.elapsed().as_nanos() as u64;
        counters.frames_received.add(batch.len() as u64);
        let mut any_dropped = false;
        for (frame, _) in batch.frames() {
            let Ok((header, rest)) = Header::ref_from_prefix(frame) else {
                counters.refused[gdp_wire::Counter::Truncated as usize].add(1);
                continue;
            };
            if let Err(counter) = forward::accept(header, frame.len(), link) {
                counters.refused[counter as usize].add(1);
                continue;
            }
            let Some(intake) = self.intakes.get_mut(&header.destination) else {
                counters.not_subscribed.add(1);
                continue;
            };
            let payload = &rest[..header.payload_len().into()];
            if let Err(reason) = intake.reader.push(now, header.source, payload, &mut self.messages) {
                any_dropped = true;
                if reason == DropReason::UnknownWriter {
                    ask_about(&mut self.asked, header.destination, header.source, events);
                }
            }
            for message in self.messages.drain(..) {
                intake.deliver(message, counters);
            }
        }
        if any_dropped {
            self.intakes.values_mut().for_each(|intake| intake.count_drops(counters));
        }
    }

    fn tick(&mut self, counters: &Counters) {
        let now = self.start.elapsed().as_nanos() as u64;
        for intake in self.intakes.values_mut() {
            intake.expire(now);
            intake.count_drops(counters);
        }
        self.asked.retain(|_, when| when.elapsed() < ASK_AGAIN);
    }
}

/// Has the supervisor find out whether `source` may write `name`. Its frames until then are lost.
fn ask_about(
    asked: &mut HashMap<(Name, Name), Instant>,
    name: Name,
    source: Name,
    events: &async_mpsc::UnboundedSender<Event>,
) {
    let recently = asked.get(&(name, source)).is_some_and(|when| when.elapsed() < ASK_AGAIN);
    if !recently && asked.len() < MAX_ASKED && events.send(Event::UnknownWriter { name }).is_ok() {
        asked.insert((name, source), Instant::now());
    }
}

fn unix_time() -> Duration {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}
