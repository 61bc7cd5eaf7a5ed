//! Generator and sink: the programs of `gdp-ebpf/src/bench.rs` at the two ends of a chain.

use std::path::Path;
use std::sync::mpsc;
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use aya::maps::{Array, DevMap, MapData};
use aya::programs::xdp::XdpMode;
use aya::programs::{ProgramError, TestRun, TestRunAttrs, TestRunOptions, Xdp};
use aya::{Ebpf, Pod};
use gdp::port::Interface;
use gdp_tests::chain::Chain;
use gdp_tests::wait::wait_for;
use gdp_wire::LinkEntry;

/// Frames the kernel sends at a time: a quarter of a veth's ring.
const BATCH: u32 = 64;

/// The kernel takes some milliseconds to begin with a test run; then caches fill.
const RUN_UP: Duration = Duration::from_millis(100);

/// How long nothing may arrive before what is missing is taken as lost.
const PATIENCE: Duration = Duration::from_millis(200);

pub struct Generator {
    /// Both programs; the sink is attached while this lives.
    programs: Ebpf,
    template: Array<MapData, Template>,
    sent: Array<MapData, u64>,
    arrived: Array<MapData, u64>,
    _out: DevMap<MapData>,
}

/// The first bytes of every frame, which forwarding changes and the generator writes anew.
#[derive(Clone, Copy)]
#[repr(transparent)]
struct Template([u64; 6]);

// SAFETY: an array of integers.
unsafe impl Pod for Template {}

/// What one measurement found.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    /// Frames per second that arrived.
    pub pps: f64,
    pub sent: u64,
    pub lost: u64,
}

impl Generator {
    /// `link`: how frames are counted and tagged; one with id 0 if they are no GDP frames.
    pub fn new(chain: &Chain, link: &LinkEntry, object: &Path) -> Result<Self> {
        let loaded = Ebpf::load_file(object);
        let mut programs = loaded.with_context(|| format!("cannot load {}", object.display()))?;
        for name in ["sink", "generate"] {
            program(&mut programs, name)?.load().with_context(|| format!("cannot load {name}"))?;
        }
        {
            let _inside = chain.cloud().enter()?;
            program(&mut programs, "sink")?.attach("l0", XdpMode::Driver).context("cannot attach the sink")?;
        }
        let mut out: DevMap<MapData> = map(&mut programs, "OUT")?;
        {
            let _inside = chain.robot().enter()?;
            out.set(0, Interface::find("r0")?.index, None, 0)?;
        }
        let mut out_link: Array<MapData, LinkEntry> = map(&mut programs, "LINK")?;
        out_link.set(0, link, 0)?;
        Ok(Self {
            template: map(&mut programs, "TEMPLATE")?,
            sent: map(&mut programs, "SENT")?,
            arrived: map(&mut programs, "ARRIVED")?,
            _out: out,
            programs,
        })
    }

    /// Sends `frame` for `duration`.
    pub fn measure(&mut self, frame: &[u8], duration: Duration) -> Result<Rate> {
        gdp_tests::wait::check_interrupt()?;
        let mut words = [0; 6];
        for (word, bytes) in words.iter_mut().zip(frame.chunks_exact(8)) {
            *word = u64::from_ne_bytes(bytes.try_into()?);
        }
        self.template.set(0, Template(words), 0)?;
        let before = self.arrived.get(&0, 0)?;
        self.sent.set(0, before, 0)?;

        let (generate, arrived) = (program(&mut self.programs, "generate")?, &self.arrived);
        let pps = std::thread::scope(|scope| -> Result<f64> {
            let (itself, thread) = mpsc::channel();
            let running = scope.spawn(move || {
                // SAFETY: no preconditions.
                itself.send(unsafe { libc::pthread_self() })?;
                send_until_signalled(generate, frame)
            });
            let thread = thread.recv()?;
            std::thread::sleep(RUN_UP);
            let (first, start) = (arrived.get(&0, 0)?, Instant::now());
            std::thread::sleep(duration);
            let (last, elapsed) = (arrived.get(&0, 0)?, start.elapsed());
            stop(thread, running)?;
            Ok((last - first) as f64 / elapsed.as_secs_f64())
        })?;

        let sent = self.sent.get(&0, 0)? - before;
        ensure!(pps > 0.0, "no frame of {sent} arrived");
        Ok(Rate { pps, sent, lost: self.lost(before, sent)? })
    }

    /// Frames that do not arrive even when waited for.
    fn lost(&self, before: u64, sent: u64) -> Result<u64> {
        let missing = || -> Result<u64> { Ok(sent - (self.arrived.get(&0, 0)? - before)) };
        let all = wait_for("the last frames", PATIENCE, || Ok((missing()? == 0).then_some(0)));
        if all.is_ok() { Ok(0) } else { missing() }
    }
}

/// The kernel ends a test run early only for a signal.
fn send_until_signalled(generate: &mut Xdp, frame: &[u8]) -> Result<()> {
    let mut options = TestRunOptions::new();
    options.data_in = Some(frame);
    options.repeat = u32::MAX;
    options.attrs = TestRunAttrs::new().xdp_live_frames(BATCH);
    match generate.test_run(options) {
        Err(ProgramError::SyscallError(error)) if error.io_error.raw_os_error() == Some(libc::EINTR) => Ok(()),
        Err(error) => Err(error).context("cannot generate frames"),
        Ok(_) => Ok(()),
    }
}

fn stop(thread: libc::pthread_t, running: ScopedJoinHandle<Result<()>>) -> Result<()> {
    extern "C" fn nothing(_: libc::c_int) {}
    // SAFETY: the handler does nothing, which is async-signal-safe.
    unsafe { libc::signal(libc::SIGUSR1, nothing as *const () as libc::sighandler_t) };
    // Once is not enough if the thread is just on its way into the kernel.
    wait_for("the generator to end", Duration::from_secs(5), || {
        // SAFETY: the thread is not joined yet, so its handle is valid.
        unsafe { libc::pthread_kill(thread, libc::SIGUSR1) };
        Ok(running.is_finished().then_some(()))
    })?;
    running.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn program<'a>(programs: &'a mut Ebpf, name: &str) -> Result<&'a mut Xdp> {
    Ok(programs.program_mut(name).with_context(|| format!("no program {name}"))?.try_into()?)
}

fn map<T: TryFrom<aya::maps::Map, Error = aya::maps::MapError>>(programs: &mut Ebpf, name: &str) -> Result<T> {
    let map = programs.take_map(name).with_context(|| format!("no map {name}"))?;
    T::try_from(map).with_context(|| format!("map {name}"))
}
