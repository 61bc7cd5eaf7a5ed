//! The loops, one for each core, and the ports that they share. Each loop receives from its own
//! queues, forwards, and sends. A packet stays with the loop that received it.
//!
//! Loops receive commands about ports between two batches, and acknowledge them. After all have
//! acknowledged a removal, no loop uses the port.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::thread::JoinHandle;
use std::time::Duration;

use arc_swap::ArcSwap;
use gdp_wire::Counter;
use parking_lot::Mutex;

use crate::forwarding::Counts;
use crate::host::{Giver, Host, ToHost, WAITING};
use crate::idle::Idle;
use crate::lane::TxLane;
use crate::local::Local;
use crate::mbuf::{Burst, CACHED, Pool};
use crate::port::{MAX_QUEUED, Port, PortConfig, PortCounters, Receive, Send};
use crate::tap::Tap;
use crate::view::Reader;
use crate::worker::{Command, LoopPort, Worker};
use crate::{DpdkError, Eal};

/// Configuration of the loops.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SwitchConfig {
    /// The core of each loop. Empty: a single loop on any core.
    pub cores: Vec<usize>,
    pub idle: Idle,
    /// Number of ports, which determines the packet memory.
    pub ports: usize,
    /// Size in bytes of the largest packet.
    pub largest: usize,
}

impl Default for SwitchConfig {
    fn default() -> Self {
        Self { cores: Vec::new(), idle: Idle::default(), ports: 2, largest: 2048 }
    }
}

/// Errors of setting up a switch.
#[derive(Debug, thiserror::Error)]
pub enum SwitchError {
    #[error(transparent)]
    Dpdk(#[from] DpdkError),
    #[error("the interface {interface} on the host's side of {device} cannot be made: {source}")]
    Tap { interface: String, device: String, source: std::io::Error },
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    #[error("a loop has ended; the log says why")]
    Ended,
}

/// The loops of a switch, and its ports. Dropping it ends the loops and releases the ports.
pub struct Switch {
    // The order of the fields is the order in which they are dropped.
    ports: HashMap<u32, Served>,
    loops: Vec<Loop>,
    local: Arc<ArcSwap<Local>>,
    host: ToHost,
    _giver: Giver,
    pool: Pool,
    eal: Eal,
}

/// A port that the switch serves.
struct Served {
    _host: Host,
    tap: Arc<Tap>,
    /// Whether the host's interface has a carrier.
    has_carrier: bool,
    port: Port,
    lost: Arc<AtomicU64>,
}

/// The thread of a loop.
struct Loop {
    commands: Option<mpsc::Sender<Command>>,
    counters: Arc<[AtomicU64; Counter::COUNT]>,
    thread: Option<JoinHandle<()>>,
    /// Clock id of the thread's processor time.
    clock: Arc<AtomicI32>,
}

impl Switch {
    /// Starts the loops, without ports. `reader`: returns a reader of the tables for each loop.
    pub fn start<R: Reader>(
        eal: Eal,
        config: &SwitchConfig,
        mut reader: impl FnMut() -> R,
    ) -> Result<Self, SwitchError> {
        let loops = config.cores.len().max(1);
        let pool = Pool::new(eal, packets(config.ports, loops), config.largest)?;
        let local: Arc<ArcSwap<Local>> = Arc::default();
        let (host, giver) = ToHost::start().map_err(SwitchError::Thread)?;
        let cores: Vec<Option<usize>> = match &config.cores[..] {
            [] => vec![None],
            cores => cores.iter().copied().map(Some).collect(),
        };
        let mut loops = Vec::new();
        for core in cores {
            let (commands, received) = mpsc::channel();
            let counters: Arc<[AtomicU64; Counter::COUNT]> = Arc::new([const { AtomicU64::new(0) }; Counter::COUNT]);
            let clock = Arc::new(AtomicI32::new(0));
            let worker = Worker::new(
                received,
                (reader(), local.clone()),
                (host.clone(), pool.clone()),
                counters.clone(),
                config.idle,
            );
            let clock_of = clock.clone();
            let thread = move || {
                clock_of.store(thread_clock(), Ordering::Relaxed);
                worker.run(eal, core);
            };
            let thread = std::thread::Builder::new().name("gdp-dpdk".into()).spawn(thread);
            let thread = Some(thread.map_err(SwitchError::Thread)?);
            loops.push(Loop { commands: Some(commands), counters, thread, clock });
        }
        Ok(Self { ports: HashMap::new(), loops, local, host, _giver: giver, pool, eal })
    }

    /// Takes over a device (see [`PortConfig::device`]) and creates `interface` as the host's
    /// interface for it, in the network namespace of the calling thread. Both get this MTU.
    /// `number`: returns the port number, by which links and tables refer to it, once the interface
    /// exists. Returns the port number and the MAC address of the device.
    pub fn add_port(
        &mut self,
        device: &str,
        (interface, mtu): (&str, u16),
        number: impl FnOnce(&str) -> std::io::Result<u32>,
    ) -> Result<(u32, [u8; 6]), SwitchError> {
        let wanted = self.loops.len() as u16;
        // A send queue for each loop, and one for the host.
        let config = PortConfig { device: device.to_owned(), receive_queues: wanted, send_queues: wanted + 1, mtu };
        let (port, receives, sends) = Port::open(self.eal, &config, &self.pool)?;
        let fail = |source| SwitchError::Tap { interface: interface.to_owned(), device: config.device.clone(), source };
        let tap = Tap::create(interface, port.mac(), port.mtu()).map_err(fail)?;
        let number = number(interface).map_err(fail)?;
        let tap = Arc::new(tap);
        let gathers = sends.first().is_some_and(Send::gathers);
        let sends: Vec<_> = sends.into_iter().map(|send| Arc::new(Mutex::new(send))).collect();
        let lost = Arc::new(AtomicU64::new(0));
        let lane = |i: usize| TxLane::new(sends[i % sends.len()].clone(), gathers, lost.clone());
        let host = Host::start(tap.clone(), (self.host.clone(), number), self.pool.clone(), lane(self.loops.len()))
            .map_err(SwitchError::Thread)?;
        let mut shares: Vec<Vec<Receive>> = self.loops.iter().map(|_| Vec::new()).collect();
        let count = shares.len();
        // Ports with a single queue are spread over the loops.
        let first = self.ports.len();
        receives.into_iter().enumerate().for_each(|(i, receive)| shares[(first + i) % count].push(receive));
        let mut answers = Vec::new();
        for (i, (one, receive)) in self.loops.iter().zip(shares).enumerate() {
            let (answer, answered) = mpsc::sync_channel(1);
            one.tell(Command::Add(Box::new(LoopPort { number, receive, lane: lane(i) }), answer))?;
            answers.push(answered);
        }
        let mac = port.mac();
        self.ports.insert(number, Served { _host: host, tap, has_carrier: true, port, lost });
        wait(answers)?;
        Ok((number, mac))
    }

    /// Releases a port. An unknown port is no error.
    pub fn remove_port(&mut self, number: u32) {
        let Some(served) = self.ports.remove(&number) else { return };
        let mut answers = Vec::new();
        for one in &self.loops {
            let (answer, answered) = mpsc::sync_channel(1);
            if one.tell(Command::Remove(number, answer)).is_ok() {
                answers.push(answered);
            }
        }
        let _ = wait(answers);
        drop(served);
    }

    /// Sets the criteria for packets to this switch, and the next hops of links over UDP.
    pub fn set_local(&self, local: Local) {
        self.local.store(Arc::new(local));
    }

    pub fn local(&self) -> Arc<Local> {
        self.local.load_full()
    }

    /// Returns the counters in the order of [`Counter::ALL`].
    pub fn counters(&self) -> Counts {
        let mut all = [0; Counter::COUNT];
        for one in &self.loops {
            all.iter_mut().zip(one.counters.iter()).for_each(|(sum, count)| *sum += count.load(Ordering::Relaxed));
        }
        all[Counter::RedirectLost as usize] = self.losses().map(|(_, lost)| lost).sum();
        all
    }

    /// Returns, for each port, the packets passed to its device or host interface that did not
    /// leave.
    pub fn losses(&self) -> impl Iterator<Item = (u32, u64)> {
        self.ports.iter().map(|(number, served)| (*number, served.lost.load(Ordering::Relaxed)))
    }

    /// Returns the counters of the devices.
    pub fn port_counters(&self) -> impl Iterator<Item = (u32, PortCounters)> {
        self.ports.iter().map(|(number, served)| (*number, served.port.counters()))
    }

    /// Copies the carrier state of the devices to the host's interfaces. `beside`: returns the
    /// carrier state of a port from another source, because some drivers cannot report it.
    pub fn follow_carriers(&mut self, beside: impl Fn(u32) -> bool) {
        for (number, served) in &mut self.ports {
            let has = served.port.has_carrier() && beside(*number);
            if has == served.has_carrier {
                continue;
            }
            served.has_carrier = has;
            let interface = served.tap.name();
            match served.tap.set_carrier(has) {
                Ok(()) => tracing::info!("{interface}: {}", if has { "the link is there again" } else { "no link" }),
                Err(error) => tracing::warn!(interface, %error, "the interface does not follow its device's carrier"),
            }
        }
    }

    /// Returns the processor time that each loop has used.
    pub fn processor_time(&self) -> Vec<Duration> {
        self.loops.iter().map(|one| read_clock(one.clock.load(Ordering::Relaxed))).collect()
    }
}

impl Drop for Switch {
    fn drop(&mut self) {
        let ports: Vec<u32> = self.ports.keys().copied().collect();
        ports.into_iter().for_each(|number| self.remove_port(number));
    }
}

impl Loop {
    fn tell(&self, command: Command) -> Result<(), SwitchError> {
        let commands = self.commands.as_ref().ok_or(SwitchError::Ended)?;
        commands.send(command).map_err(|_| SwitchError::Ended)
    }
}

impl Drop for Loop {
    fn drop(&mut self) {
        drop(self.commands.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Waits until all loops have executed their command.
fn wait(answers: Vec<Receiver<()>>) -> Result<(), SwitchError> {
    answers.into_iter().try_for_each(|answered| answered.recv().map_err(|_| SwitchError::Ended))
}

/// Returns the number of packet buffers that all port queues, the loops and the host queue may
/// occupy. With fewer, transmit queues could leave no buffers for receiving.
fn packets(ports: usize, loops: usize) -> u32 {
    let queues = ports * (loops + loops + 1) * MAX_QUEUED;
    let under_way = loops * (CACHED + Burst::SIZE * (ports + 2));
    // A pool performs best with a power of two minus one.
    ((queues + under_way + WAITING).next_power_of_two() - 1) as u32
}

/// Returns the clock of the calling thread's processor time, which other threads can read.
fn thread_clock() -> i32 {
    let mut clock = 0;
    // SAFETY: the call refers to the calling thread, and writes a number to valid memory.
    unsafe { libc::pthread_getcpuclockid(libc::pthread_self(), &raw mut clock) };
    clock
}

fn read_clock(clock: i32) -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the memory for the result is valid. For a thread that has ended, the call fails and
    // the time stays zero.
    unsafe { libc::clock_gettime(clock, &raw mut time) };
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}
