//! Generators and sink: the programs of `gdp-ebpf/src/bench.rs` at the two ends of a chain.
//!
//! XDP programs and the kernel's routers run on the generator's pinned core, because veths work
//! that way. Threads of the userspace plane use the other cores.

use std::path::Path;
use std::sync::mpsc;
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use aya::maps::{Array, DevMap, Map, MapData, MapError};
use aya::programs::xdp::XdpMode;
use aya::programs::{ProgramError, TestRun, TestRunAttrs, TestRunOptions, Xdp};
use aya::{Ebpf, Pod};
use gdp_link::port::Interface;
use gdp_tests::chain::Chain;
use gdp_tests::measure::cpu;
use gdp_tests::measure::rounds::Sample;
use gdp_tests::netns::Namespace;
use gdp_tests::wait::wait_for;
use gdp_wire::LinkEntry;

use crate::Bench;

/// Frames that the kernel sends at a time: a quarter of a veth's ring.
const BATCH: u64 = 64;

/// Most frames in flight. Fewer than a veth's ring of 256 would slow planes that work in batches.
/// More than a packet socket's receive buffer would lose frames.
const WINDOW: u64 = 1024;

/// Longest time until the kernel begins a test run.
const START: Duration = Duration::from_secs(5);

/// Further time to fill caches.
const RUN_UP: Duration = Duration::from_millis(50);

/// Time without arrivals after which missing frames count as lost.
const TIMEOUT: Duration = Duration::from_millis(200);

/// A loaded bench object; its programs stay attached until it is dropped.
pub struct Programs(Ebpf);

impl Programs {
    pub fn load(object: &Path, names: &[&str]) -> Result<Self> {
        let mut programs = Self(Ebpf::load_file(object).with_context(|| format!("cannot load {}", object.display()))?);
        names.iter().try_for_each(|name| programs.load_program(name))?;
        Ok(programs)
    }

    fn load_program(&mut self, name: &str) -> Result<()> {
        self.program(name)?.load().with_context(|| format!("cannot load {name}"))
    }

    pub fn program(&mut self, name: &str) -> Result<&mut Xdp> {
        Ok(self.0.program_mut(name).with_context(|| format!("no program {name}"))?.try_into()?)
    }

    /// Takes a map; at most once per map.
    pub fn map<T: TryFrom<Map, Error = MapError>>(&mut self, name: &str) -> Result<T> {
        let map = self.0.take_map(name).with_context(|| format!("no map {name}"))?;
        T::try_from(map).with_context(|| format!("map {name}"))
    }

    /// Attaches a program to an interface of the calling thread's network namespace.
    pub fn attach(&mut self, name: &str, interface: &str) -> Result<()> {
        let attached = self.program(name)?.attach(interface, XdpMode::Driver);
        attached.map(drop).with_context(|| format!("cannot attach {name} to {interface}"))
    }
}

/// The frames of a generator.
#[derive(Clone)]
pub struct Frames {
    /// A template frame; all others differ in counter and tag alone.
    pub frame: Vec<u8>,
    /// Offset of the GDP header in the frame.
    pub header_at: usize,
    /// The link whose id, counter and keys the frames use.
    pub link: LinkEntry,
    /// False for a switch to which every tag is 0. The generator still computes the tag.
    pub tagged: bool,
    pub spread: Spread,
}

/// The number of arrivals per frame, and the limit of frames in flight.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    /// Frames that arrive for each frame sent.
    pub copies: u64,
    /// Most frames in flight, counted in expected arrivals.
    pub window: u64,
    /// The frame goes nowhere, and counts as arrived.
    pub discard: bool,
}

impl Spread {
    pub const SINGLE: Self = Self { copies: 1, window: WINDOW, discard: false };
}

const TEMPLATE_WORDS: usize = 13;

/// Layout as in `gdp-ebpf/src/bench.rs`.
#[derive(Clone, Copy)]
#[repr(C)]
struct Pattern {
    template: [u64; TEMPLATE_WORDS],
    tag_mask: u64,
    known_interval: u64,
    unknown_interval: u64,
    header_at: u64,
    copies: u64,
    window: u64,
    discard: u64,
}

// SAFETY: an array of integers, and integers of the same size.
unsafe impl Pod for Pattern {}

/// Frames per second that [`Traffic::flood`] sends.
#[derive(Clone, Copy, Debug)]
pub struct Offered {
    pub known: u32,
    pub unknown: u32,
}

/// Counts the frames that arrive at an interface, and drops them.
pub struct Sink {
    programs: Programs,
    arrived: Array<MapData, u64>,
}

impl Sink {
    pub fn attach(at: &Namespace, interface: &str, bench: &Bench) -> Result<Self> {
        let _inside = at.enter()?;
        let mut programs = Programs::load(&bench.bench_object, &["sink"])?;
        programs.attach("sink", interface)?;
        Ok(Self { arrived: programs.map("ARRIVED")?, programs })
    }

    /// Attaches to another interface as well.
    pub fn attach_to(&mut self, at: &Namespace, interface: &str) -> Result<()> {
        let _inside = at.enter()?;
        self.programs.attach("sink", interface)
    }

    /// Returns the frames counted so far.
    pub fn arrived(&self) -> Result<u64> {
        Ok(self.arrived.get(&0, 0)?)
    }
}

/// The generators on one interface, and sinks on others.
pub struct Traffic {
    /// The generators are in the sink's object: they read its arrival counter.
    sink: Sink,
    frames: Frames,
    pattern: Array<MapData, Pattern>,
    sent: Array<MapData, u64>,
    link_count: Array<MapData, u64>,
    _out: DevMap<MapData>,
}

impl Traffic {
    /// Connects the robot's interface of a chain to the cloud's.
    pub fn new(chain: &Chain, frames: Frames, bench: &Bench) -> Result<Self> {
        let sink = Sink::attach(chain.cloud(), "l0", bench)?;
        Self::from(chain.robot(), "r0", sink, frames)
    }

    pub fn from(at: &Namespace, interface: &str, mut sink: Sink, frames: Frames) -> Result<Self> {
        let programs = &mut sink.programs;
        for generator in ["generate", "flood"] {
            programs.load_program(generator)?;
        }
        let mut out: DevMap<MapData> = programs.map("OUT")?;
        {
            let _inside = at.enter()?;
            out.set(0, Interface::find(interface)?.index, None, 0)?;
        }
        let mut link: Array<MapData, LinkEntry> = programs.map("LINK")?;
        link.set(0, frames.link, 0)?;
        Ok(Self {
            pattern: programs.map("PATTERN")?,
            sent: programs.map("SENT")?,
            link_count: programs.map("LINK_COUNT")?,
            _out: out,
            frames,
            sink,
        })
    }

    /// Sends other frames on the same link from now on.
    pub fn change(&mut self, frame: Vec<u8>, spread: Spread) {
        self.frames = Frames { frame, spread, ..self.frames.clone() };
    }

    /// Returns frames per second that arrive. The number in flight is limited, so the rate has no
    /// loss.
    pub fn rate(&mut self, duration: Duration) -> Result<Sample> {
        self.run("generate", Offered { known: 0, unknown: 0 }, duration).map(|run| run.known)
    }

    /// Returns frames per second that arrive at the known name while other frames go to unknown
    /// names, both sent at a fixed rate.
    pub fn flood(&mut self, offered: Offered, duration: Duration) -> Result<Run> {
        self.run("flood", offered, duration)
    }

    fn run(&mut self, program: &str, offered: Offered, duration: Duration) -> Result<Run> {
        self.pattern.set(0, self.frames.pattern(offered), 0)?;
        let before = self.sink.arrived()?;
        self.sent.set(0, before, 0)?;

        let (generator, frames) = (self.sink.programs.program(program)?, &self.frames);
        let (arrived, link_count, sent) = (&self.sink.arrived, &self.link_count, &self.sent);
        let now = || -> Result<Timestamps> {
            let unknown = link_count.get(&0, 0)?.wrapping_sub(sent.get(&0, 0)?);
            Ok(Timestamps { arrived: arrived.get(&0, 0)?, unknown, at: Instant::now() })
        };
        let (known, unknown) = std::thread::scope(|scope| -> Result<(f64, f64)> {
            let (itself, thread) = mpsc::channel();
            let running = scope.spawn(move || {
                // SAFETY: no preconditions.
                itself.send(unsafe { libc::pthread_self() })?;
                send_until_signalled(generator, frames)
            });
            let thread = thread.recv()?;
            let measured = (|| -> Result<(Timestamps, Timestamps)> {
                let begun = || Ok((arrived.get(&0, 0)? > before).then_some(()));
                wait_for("the first frame to arrive", START, begun)?;
                std::thread::sleep(RUN_UP);
                let first = now()?;
                std::thread::sleep(duration);
                Ok((first, now()?))
            })();
            // Also after a failure, because the generator does not end by itself.
            stop(thread, running)?;
            let (first, last) = measured?;
            let seconds = (last.at - first.at).as_secs_f64();
            let per_second = |of: fn(&Timestamps) -> u64| of(&last).wrapping_sub(of(&first)) as f64 / seconds;
            Ok((per_second(|moment| moment.arrived), per_second(|moment| moment.unknown)))
        })?;

        let sent = self.sent.get(&0, 0)? - before;
        ensure!(known > 0.0, "no frame arrived within {duration:?}");
        let lost = self.lost(before, sent)?;
        Ok(Run { known: Sample { value: known, sent, lost }, unknown })
    }

    /// Returns the number of frames that have not arrived after the timeout.
    fn lost(&self, before: u64, sent: u64) -> Result<u64> {
        let missing = || -> Result<u64> { Ok(sent - (self.sink.arrived()? - before)) };
        let all = wait_for("the last frames", TIMEOUT, || Ok((missing()? == 0).then_some(0)));
        if all.is_ok() { Ok(0) } else { missing() }
    }
}

/// Counters at one time.
struct Timestamps {
    arrived: u64,
    /// Frames to unknown names, plus a constant.
    unknown: u64,
    at: Instant,
}

/// The result of a flood.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    pub known: Sample,
    /// Frames sent to unknown names per second.
    pub unknown: f64,
}

impl Frames {
    fn pattern(&self, offered: Offered) -> Pattern {
        let mut template = [0; TEMPLATE_WORDS];
        for (word, bytes) in template.iter_mut().zip(self.frame.as_chunks().0) {
            *word = u64::from_ne_bytes(*bytes);
        }
        let interval = |rate| 1_000_000_000u64.checked_div(u64::from(rate)).unwrap_or(0);
        Pattern {
            template,
            tag_mask: if self.tagged { u64::MAX } else { 0 },
            known_interval: interval(offered.known),
            unknown_interval: interval(offered.unknown),
            header_at: self.header_at as u64,
            copies: self.spread.copies,
            window: self.spread.window,
            discard: self.spread.discard.into(),
        }
    }

    /// Returns the number of frames that the kernel sends at a time. It must not exceed the window:
    /// the generator drops the excess frames.
    fn batch(&self) -> u32 {
        (self.spread.window / self.spread.copies).clamp(1, BATCH) as u32
    }
}

/// Sends until a signal arrives; the kernel ends a test run early for no other reason.
fn send_until_signalled(generator: &mut Xdp, frames: &Frames) -> Result<()> {
    cpu::pin(cpu::SENDER)?;
    let mut options = TestRunOptions::new();
    options.data_in = Some(&frames.frame);
    options.repeat = u32::MAX;
    options.attrs = TestRunAttrs::new().xdp_live_frames(frames.batch());
    match generator.test_run(options) {
        Err(ProgramError::SyscallError(error)) if error.io_error.raw_os_error() == Some(libc::EINTR) => Ok(()),
        Err(error) => Err(error).context("cannot generate frames"),
        Ok(_) => Ok(()),
    }
}

fn stop(thread: libc::pthread_t, running: ScopedJoinHandle<Result<()>>) -> Result<()> {
    extern "C" fn nothing(_: libc::c_int) {}
    // SAFETY: the handler does nothing, which is async-signal-safe.
    unsafe { libc::signal(libc::SIGUSR1, nothing as *const () as libc::sighandler_t) };
    // One signal is not enough if the thread is just entering the kernel.
    wait_for("the generator to end", Duration::from_secs(5), || {
        // SAFETY: the thread is not joined yet, so its handle is valid.
        unsafe { libc::pthread_kill(thread, libc::SIGUSR1) };
        Ok(running.is_finished().then_some(()))
    })?;
    running.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
