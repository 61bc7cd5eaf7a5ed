//! A loop: polls its queues for packets, forwards them, and sends.

use crate::lane::TxLane;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError};

use arc_swap::ArcSwap;
use gdp_wire::Counter;

use crate::Eal;
use crate::forwarding::{Forwarding, Sink};
use crate::host::ToHost;
use crate::idle::{Idle, Rest, sleep_exactly};
use crate::local::Local;
use crate::mbuf::{Burst, Mbuf, Pool};
use crate::port::Receive;
use crate::view::Reader;

/// Number of empty rounds after which a loop enters the tables anyway.
const LOOK: u32 = 512;

/// Command to a loop.
pub enum Command {
    Add(Box<LoopPort>, SyncSender<()>),
    Remove(u32, SyncSender<()>),
}

/// A port as a loop uses it.
pub struct LoopPort {
    pub number: u32,
    pub receive: Vec<Receive>,
    pub lane: TxLane,
}

/// State of a loop.
pub struct Worker<R> {
    commands: Receiver<Command>,
    reader: R,
    local: Arc<ArcSwap<Local>>,
    forwarding: Forwarding,
    out: Out,
    /// Receive queues, each with the index of its port among the lanes.
    receives: Vec<(usize, Receive)>,
    numbers: Vec<u32>,
    counters: Arc<[AtomicU64; Counter::COUNT]>,
    rest: Rest,
}

impl<R: Reader> Worker<R> {
    pub fn new(
        commands: Receiver<Command>,
        (reader, local): (R, Arc<ArcSwap<Local>>),
        (host, pool): (ToHost, Pool),
        counters: Arc<[AtomicU64; Counter::COUNT]>,
        idle: Idle,
    ) -> Self {
        Self {
            commands,
            reader,
            local,
            forwarding: Forwarding::new(pool),
            out: Out { lanes: Vec::new(), host, from: 0 },
            receives: Vec::new(),
            numbers: Vec::new(),
            counters,
            rest: Rest::new(idle),
        }
    }

    /// Runs the loop on this thread until all command senders are dropped. Binds the thread to
    /// `core`, if given.
    pub fn run(mut self, eal: Eal, core: Option<usize>) {
        core.into_iter().for_each(bind_to);
        sleep_exactly();
        let _registered = match eal.register() {
            Ok(registered) => registered,
            Err(error) => return tracing::error!(%error, "a loop of the DPDK data plane does not start"),
        };
        let (mut burst, mut vain) = (Burst::new(), 0u32);
        let mut local = arc_swap::Cache::new(self.local.clone());
        loop {
            match self.commands.try_recv() {
                Ok(command) => self.obey(command),
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => return,
            }
            let mut any = false;
            for (port, receive) in &mut self.receives {
                if receive.receive(&mut burst) == 0 {
                    continue;
                }
                any = true;
                self.out.from = *port;
                let mut counts = [0; Counter::COUNT];
                let at = (self.numbers[*port], &self.numbers[..]);
                let tables = (&self.reader.enter(), &**local.load());
                self.forwarding.run(at, &mut burst, tables, &mut self.out, &mut counts);
                for (counter, count) in self.counters.iter().zip(counts).filter(|(_, count)| *count > 0) {
                    // This thread is the only writer.
                    counter.store(counter.load(Ordering::Relaxed) + count, Ordering::Relaxed);
                }
            }
            if any {
                self.out.flush();
            }
            vain = if any { 0 } else { vain.wrapping_add(1) };
            if vain % LOOK == LOOK - 1 {
                // Allow removed table entries to be freed.
                drop(self.reader.enter());
                local.load();
            }
            match self.rest.after(any) {
                Some(sleep) => std::thread::sleep(sleep),
                None if any => {}
                None => std::hint::spin_loop(),
            }
        }
    }

    fn obey(&mut self, command: Command) {
        match command {
            Command::Add(port, answer) => {
                let LoopPort { number, receive, lane } = *port;
                let place = self.out.lanes.len();
                self.out.lanes.push((number, lane));
                self.numbers.push(number);
                self.receives.extend(receive.into_iter().map(|receive| (place, receive)));
                let _ = answer.send(());
            }
            Command::Remove(number, answer) => {
                if let Some(place) = self.numbers.iter().position(|of| *of == number) {
                    self.numbers.remove(place);
                    self.out.lanes.remove(place);
                    self.receives.retain(|(of, _)| *of != place);
                    self.receives.iter_mut().filter(|(of, _)| *of > place).for_each(|(of, _)| *of -= 1);
                }
                let _ = answer.send(());
            }
        }
    }
}

/// Egress of a loop's packets.
struct Out {
    lanes: Vec<(u32, TxLane)>,
    host: ToHost,
    /// Index of the port whose packets are being processed.
    from: usize,
}

impl Out {
    fn flush(&mut self) {
        self.lanes.iter_mut().for_each(|(_, lane)| lane.flush());
    }

    fn lane(&mut self, port: u32) -> Option<&mut TxLane> {
        self.lanes.iter_mut().find(|(number, _)| *number == port).map(|(_, lane)| lane)
    }
}

impl Sink for Out {
    fn send(&mut self, port: u32, mbuf: Mbuf) {
        // The lane exists, because decisions select only existing ports.
        if let Some(lane) = self.lane(port) {
            lane.send(mbuf);
        }
    }

    fn pass(&mut self, mbuf: Mbuf) {
        if let Some((number, lane)) = self.lanes.get(self.from)
            && !self.host.give(*number, mbuf)
        {
            lane.lost.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn gathers(&self, port: u32) -> bool {
        self.lanes.iter().any(|(number, lane)| *number == port && lane.gathers)
    }
}

/// Binds the calling thread to a core.
fn bind_to(core: usize) {
    // SAFETY: the set has only plain bits, which may all be zero, and the size matches.
    let result = unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        libc::CPU_SET(core, &mut set);
        libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set)
    };
    if result != 0 {
        let error = std::io::Error::last_os_error();
        tracing::warn!(core, %error, "a loop of the DPDK data plane is not bound to its core");
    }
}
