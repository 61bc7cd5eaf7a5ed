//! Generator and sink: the programs of `gdp-ebpf/src/bench.rs` at the two ends of a chain.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use aya::maps::{Array, DevMap, MapData, PerCpuArray};
use aya::programs::xdp::XdpMode;
use aya::programs::{TestRun, TestRunAttrs, TestRunOptions, Xdp};
use aya::{Ebpf, Pod};
use gdp_tests::chain::Chain;
use gdp_tests::netns::Namespace;

/// Frames the kernel sends at a time: a quarter of a veth's ring.
const BATCH: u32 = 64;

/// How long nothing may arrive before what is missing is taken as lost.
const PATIENCE: Duration = Duration::from_millis(100);

pub struct Generator {
    generator: Ebpf,
    template: Array<MapData, Template>,
    arrived: PerCpuArray<MapData, u64>,
    /// Attached while this lives.
    _sink: Ebpf,
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
    pub fn new(chain: &Chain, object: &Path) -> Result<Self> {
        let load = || Ebpf::load_file(object).with_context(|| format!("cannot load {}", object.display()));
        let mut sink = load()?;
        let l0 = {
            let _inside = chain.cloud().enter()?;
            program(&mut sink, "sink")?.attach("l0", XdpMode::Driver)
        };
        l0.context("cannot attach the sink")?;

        let mut generator = load()?;
        program(&mut generator, "generate")?;
        let mut out: DevMap<MapData> = map(&mut generator, "OUT")?;
        {
            let _inside = chain.robot().enter()?;
            out.set(0, ifindex(chain.robot(), "r0")?, None, 0)?;
        }
        let template = map(&mut generator, "TEMPLATE")?;
        let arrived = map(&mut sink, "ARRIVED")?;
        Ok(Self { generator, template, arrived, _sink: sink, _out: out })
    }

    /// Sends `frame` for `duration`, `chunk` at a time.
    pub fn measure(&mut self, frame: &[u8], chunk: u32, duration: Duration) -> Result<Rate> {
        let mut words = [0; 6];
        for (word, bytes) in words.iter_mut().zip(frame.chunks_exact(8)) {
            *word = u64::from_ne_bytes(bytes.try_into()?);
        }
        self.template.set(0, Template(words), 0)?;

        let before = self.arrived()?;
        let (mut sent, mut lost) = (0, 0);
        let start = Instant::now();
        while start.elapsed() < duration {
            gdp_tests::wait::check_interrupt()?;
            self.send(frame, chunk)?;
            sent += u64::from(chunk);
            lost = self.wait_for(before, sent, lost)?;
        }
        let arrived = self.arrived()? - before;
        ensure!(arrived > 0, "no frame of {sent} arrived");
        Ok(Rate { pps: arrived as f64 / start.elapsed().as_secs_f64(), sent, lost })
    }

    fn send(&mut self, frame: &[u8], count: u32) -> Result<()> {
        let mut options = TestRunOptions::new();
        options.data_in = Some(frame);
        options.repeat = count;
        options.attrs = TestRunAttrs::new().xdp_live_frames(BATCH);
        let generate: &mut Xdp = self.generator.program_mut("generate").context("generate")?.try_into()?;
        generate.test_run(options)?;
        Ok(())
    }

    /// Waits until all frames but those lost so far are there; returns how many are lost now.
    fn wait_for(&self, before: u64, sent: u64, lost: u64) -> Result<u64> {
        let (mut last, mut since) = (0, Instant::now());
        loop {
            let arrived = self.arrived()? - before;
            if arrived + lost >= sent {
                return Ok(lost);
            }
            if arrived != last {
                (last, since) = (arrived, Instant::now());
            } else if since.elapsed() > PATIENCE {
                return Ok(sent - arrived);
            }
            // Leaves the core to the forwarders.
            std::thread::sleep(Duration::from_micros(50));
        }
    }

    fn arrived(&self) -> Result<u64> {
        Ok(self.arrived.get(&0, 0)?.iter().sum())
    }
}

fn program<'a>(ebpf: &'a mut Ebpf, name: &str) -> Result<&'a mut Xdp> {
    let program: &mut Xdp = ebpf.program_mut(name).with_context(|| format!("no program {name}"))?.try_into()?;
    program.load().with_context(|| format!("cannot load {name}"))?;
    Ok(program)
}

fn map<T: TryFrom<aya::maps::Map, Error = aya::maps::MapError>>(ebpf: &mut Ebpf, name: &str) -> Result<T> {
    let map = ebpf.take_map(name).with_context(|| format!("no map {name}"))?;
    T::try_from(map).with_context(|| format!("map {name}"))
}

fn ifindex(node: &Namespace, interface: &str) -> Result<u32> {
    let shown = node.ip(&["-o", "link", "show", interface])?;
    let index = shown.split(':').next().and_then(|index| index.trim().parse().ok());
    index.with_context(|| format!("no index in {shown:?}"))
}
