//! Moves frames between data sockets according to [`super::userspace::handle`], with one thread for
//! each receiving socket. A thread enters the tables once for each batch and allocates nothing for
//! it.

pub use crate::forwarder_state::{Medium, Shared, sockets};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use gdp_link::port::{BATCH, DataSocket, InFrame, LinkAddr, OutFrame, RecvBatch};
use gdp_wire::counter::is_sampled;
use gdp_wire::{Counter, Header};
use zerocopy::{FromBytes, IntoBytes};

use super::tables::TablesReader;
use super::userspace::{CopyOut, Outcome, copies, handle};

/// Number of frames a thread sends to an interface without a queue before it checks for a queue
/// again.
const LOOK: usize = 16;

/// Maximum time for which a thread without traffic retains tables that were replaced. Links wake
/// it at once ([`Forwarder::wake`]).
const RETAIN: Duration = Duration::from_secs(10);

/// Pause after a failure of the socket.
const PAUSE: Duration = Duration::from_millis(100);

/// The thread of one socket. Dropping it ends the thread; frames to that medium are then lost and
/// counted.
pub struct Forwarder {
    medium: Medium,
    socket: Arc<DataSocket>,
    shared: Arc<Shared>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Forwarder {
    /// Starts the thread. `largest`: size in bytes of the largest frame that the socket can
    /// deliver.
    pub fn start(
        medium: Medium,
        socket: Arc<DataSocket>,
        largest: usize,
        shared: &Arc<Shared>,
        tables: TablesReader,
    ) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        sockets(shared, |sockets| sockets.insert(medium, socket.clone()));
        let worker = Worker {
            socket: socket.clone(),
            shared: shared.clone(),
            tables,
            stop: stop.clone(),
            batch: RecvBatch::new(largest),
            sends: Vec::with_capacity(BATCH),
            unseen: Vec::new(),
        };
        let thread = std::thread::Builder::new().name("gdp-forward".into()).spawn(move || worker.run())?;
        Ok(Self { medium, socket, shared: shared.clone(), stop, thread: Some(thread) })
    }

    /// Tells the thread to end, without waiting for it.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
        self.wake();
    }

    /// Lets the thread release what was removed from the tables.
    pub fn wake(&self) {
        self.socket.wake();
    }
}

impl Drop for Forwarder {
    fn drop(&mut self) {
        self.stop();
        sockets(&self.shared, |sockets| sockets.remove(&self.medium));
        if let Medium::Ethernet(ifindex) = self.medium {
            self.shared.queues.note(ifindex, 0);
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Worker {
    socket: Arc<DataSocket>,
    shared: Arc<Shared>,
    tables: TablesReader,
    stop: Arc<AtomicBool>,
    batch: RecvBatch,
    /// Frames of the batch to send.
    sends: Vec<Send>,
    /// Number of frames sent to each interface since the last check of its queue.
    unseen: Vec<(u32, usize)>,
}

/// A frame of the batch, or a copy of it.
struct Send {
    frame: usize,
    to: LinkAddr,
    length: usize,
    /// Header that replaces the frame's own.
    header: Option<Header>,
    counter: Counter,
}

impl Worker {
    fn run(mut self) {
        while !self.stop.load(Ordering::Relaxed) {
            // Enter the tables also without traffic, so that the keys of removed links are freed.
            drop(self.tables.enter());
            let received = match self.socket.wait_readable(RETAIN) {
                Ok(false) => continue,
                Ok(true) => self.socket.try_recv_batch(&mut self.batch),
                Err(error) => Err(error),
            };
            match received {
                Ok(0) => {}
                Ok(_) => {
                    self.look_at_queues();
                    self.decide();
                    self.send();
                }
                Err(error) => {
                    tracing::warn!(%error, "a data socket failed; trying on");
                    std::thread::park_timeout(PAUSE);
                }
            }
        }
    }

    /// Checks the queues of interfaces before this batch adds to them. Frames still queued there
    /// are waiting.
    fn look_at_queues(&mut self) {
        let shared = &self.shared;
        let due = self.unseen.extract_if(.., |(_, frames)| *frames >= LOOK).map(|(ifindex, _)| ifindex);
        shared.queues.look(due, |ifindex| {
            let sockets = shared.sockets.read();
            sockets.get(&Medium::Ethernet(ifindex)).map_or(0, |socket| socket.send_queue())
        });
    }

    fn decide(&mut self) {
        let mut counts = [0u64; Counter::COUNT];
        let tables = self.tables.enter();
        for (index, InFrame { bytes: frame, congested, .. }) in self.batch.frames().enumerate() {
            let arrived = Header::read_from_prefix(frame).ok().map(|(header, _)| (header.link_id(), header.tag()));
            let outcome = handle(frame, congested, &tables);
            let counter = match outcome {
                Outcome::Send { to, length, counter, .. } => {
                    self.sends.push(Send { frame: index, to, length, header: None, counter });
                    counter
                }
                Outcome::Copies { ingress, group } => {
                    let send = |CopyOut { to, header, counter, .. }| {
                        let length = header.frame_len();
                        self.sends.push(Send { frame: index, to, length, header: Some(header), counter });
                    };
                    copies(frame, (ingress, group), &tables, send, |counter| counts[counter as usize] += 1);
                    Counter::Replicated
                }
                Outcome::Control => Counter::Control,
                Outcome::Notice { link, header } => {
                    let payload = frame.get(Header::LEN..header.frame_len()).unwrap_or_default();
                    self.shared.notices.take(link, &header, payload)
                }
                Outcome::Drop(counter) => counter,
            };
            if !matches!(outcome, Outcome::Send { .. }) {
                counts[counter as usize] += 1;
            }
            if let Some((link, tag)) = arrived {
                self.shared.tally.count_arrivals(link, counter, 1);
                if let Ok((header, _)) = Header::read_from_prefix(frame)
                    && counter.is_onward()
                    && is_sampled(tag)
                {
                    self.shared.tally.sample(&header.destination);
                }
            }
        }
        drop(tables);
        for (counter, frames) in Counter::ALL.iter().zip(counts) {
            self.shared.count(*counter, frames);
        }
    }

    fn send(&mut self) {
        // All frames of a batch usually leave by one socket, so this loop usually runs once.
        while let Some(first) = self.sends.first() {
            let medium = Medium::from(first.to);
            let socket = {
                let sockets = self.shared.sockets.read();
                sockets.get(&medium).cloned()
            };
            let mut intended = [0u64; Counter::COUNT];
            let here = self.sends.iter().filter(|send| Medium::from(send.to) == medium);
            here.clone().for_each(|send| intended[send.counter as usize] += 1);
            if let Medium::Ethernet(ifindex) = medium {
                let frames = here.clone().count();
                match self.unseen.iter_mut().find(|(of, _)| *of == ifindex) {
                    Some((_, unseen)) => *unseen += frames,
                    None => self.unseen.push((ifindex, frames)),
                }
            }
            let frames = here.map(|send| {
                let frame = &self.batch.frame(send.frame)[..send.length];
                match &send.header {
                    Some(header) => OutFrame { to: send.to, head: header.as_bytes(), body: &frame[Header::LEN..] },
                    None => OutFrame { to: send.to, head: frame, body: &[] },
                }
            });
            let lost = match socket {
                Some(socket) => socket.send_batch(frames).lost as u64,
                None => frames.count() as u64,
            };
            self.account(intended, lost);
            self.sends.retain(|send| Medium::from(send.to) != medium);
        }
    }

    /// Counts the frames of a batch under the counters of their forwarding decisions, except lost
    /// frames. The socket does not report which frames were lost, so losses are subtracted in the
    /// order of the counters.
    fn account(&self, intended: [u64; Counter::COUNT], lost: u64) {
        let mut open = lost;
        for (counter, frames) in Counter::ALL.iter().zip(intended) {
            let failed = frames.min(open);
            open -= failed;
            self.shared.count(*counter, frames - failed);
        }
        self.shared.count(Counter::RedirectFailed, lost - open);
    }
}
