//! Counts frames lost after a redirect, when the switch has already made its decision. It loads the
//! eBPF programs for the kernel's tracepoints, sets the interfaces they watch, and reads their
//! counters. [`gdp_wire::Counter::RedirectLost`] defines the counts. Part of [`super::kernel`].
//!
//! The programs cannot see frames that an interface accepts and later loses, for example in the
//! ring of a veth whose peer goes down. They also cannot see packets sent by generic XDP, which are
//! ordinary packets of the host (`ip -s link`, `dropped`).

use std::collections::HashMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use aya::maps::{MapData, MapError, PerCpuHashMap, PerCpuValues};
use aya::pin::PinError;
use aya::programs::links::{FdLink, PinnedLink};
use aya::programs::{ProgramError, RawTracePoint};
use aya::{Ebpf, util};
use gdp_wire::losses::NetDevices;

use super::kernel_types::{KernelTypes, TypesError, VMLINUX};
use super::pins::Pins;
use super::{kernel_errors, verified};

/// Name of the map in the object, and in a folder of pins.
pub const MAP: &str = "REDIRECT_LOSSES";

/// The global of the object that contains the field offsets and the namespace.
pub const WHERE: &str = "NET_DEVICES";

/// Programs of the object, with their tracepoints.
const PROGRAMS: [(&str, &str); 2] = [("gdp_devmap_xmit", "xdp_devmap_xmit"), ("gdp_redirect_err", "xdp_redirect_err")];

/// Reasons why losses are not counted, or only in part.
#[derive(Debug, thiserror::Error)]
pub enum LossesError {
    #[error("frames lost after a redirect are not counted, as was asked for")]
    Unwanted,
    #[error(transparent)]
    Types(#[from] TypesError),
    #[error("cannot tell the network namespace: {0}")]
    Namespace(std::io::Error),
    #[error(
        "the eBPF object has no program `{0}`; it belongs to another version: `cargo xtask build` makes the right one"
    )]
    NoProgram(&'static str),
    #[error("tracepoint {tracepoint}: {}", kernel_errors::program(source))]
    Program { tracepoint: &'static str, source: ProgramError },
    #[error("tracepoint {tracepoint}: the program cannot be made to outlive the daemon: {source}")]
    Pin { tracepoint: &'static str, source: PinError },
    #[error("{}: {source}", path.display())]
    Unpin { path: PathBuf, source: std::io::Error },
    #[error("BPF map {MAP}: {0}")]
    Map(#[from] MapError),
}

/// Counters of frames lost on their way to the interfaces of a switch.
pub struct Losses {
    counts: PerCpuHashMap<MapData, u32, u64>,
    /// Dropping them detaches the programs, unless they are pinned.
    programs: Vec<Attached>,
}

enum Attached {
    Here { _link: FdLink },
    Pinned { _link: PinnedLink },
}

impl Losses {
    /// Creates the counters from the object's map. Nothing is counted yet.
    pub fn new(counts: PerCpuHashMap<MapData, u32, u64>) -> Self {
        Self { counts, programs: Vec::new() }
    }

    /// Attaches the programs, replacing those of an earlier daemon. `ebpf` must have been loaded
    /// with [`net_devices`].
    pub fn start(&mut self, ebpf: &mut Ebpf, pins: Option<&Pins>) -> Result<(), LossesError> {
        if !self.programs.is_empty() {
            return Ok(());
        }
        let attached = PROGRAMS.map(|(program, tracepoint)| attach(ebpf, program, tracepoint, pins));
        self.programs = attached.into_iter().collect::<Result<_, _>>()?;
        Ok(())
    }

    /// Counts for exactly these interfaces from now on. Counts of interfaces that remain are
    /// preserved.
    pub fn watch(&mut self, interfaces: &[u32]) -> Result<(), LossesError> {
        let known: Vec<u32> = self.counts.keys().collect::<Result<_, _>>()?;
        known.iter().filter(|known| !interfaces.contains(known)).try_for_each(|gone| self.counts.remove(gone))?;
        for new in interfaces.iter().filter(|new| !known.contains(new)) {
            let cpus = util::nr_cpus().map_err(|(_, source)| MapError::IoError(source))?;
            self.counts.insert(new, PerCpuValues::try_from(vec![0; cpus]).map_err(MapError::IoError)?, 0)?;
        }
        Ok(())
    }

    /// Returns the frames lost so far, by interface.
    pub fn counts(&self) -> Result<HashMap<u32, u64>, MapError> {
        sums(&self.counts)
    }
}

/// Returns the frames lost so far, by interface, from a folder of pins. The result is empty if the
/// daemon of these pins did not count losses.
pub fn pinned_counts(folder: &Path) -> Result<HashMap<u32, u64>, MapError> {
    let path = folder.join(MAP);
    if !path.exists() {
        return Ok(HashMap::new());
    }
    sums(&PerCpuHashMap::try_from(aya::maps::Map::PerCpuHashMap(MapData::from_pin(path)?))?)
}

/// Returns the offsets at which programs find interface and namespace in this kernel, and the
/// calling thread's namespace.
pub fn net_devices() -> Result<NetDevices, LossesError> {
    let types = KernelTypes::load(Path::new(VMLINUX))?;
    let namespace = std::fs::metadata("/proc/thread-self/ns/net").map_err(LossesError::Namespace)?;
    Ok(NetDevices {
        // The kernel uses 32 bits for it.
        namespace: namespace.ino() as u32,
        ifindex: types.offset("net_device", &["ifindex"])?,
        net: types.offset("net_device", &["nd_net", "net"])?,
        inum: types.offset("net", &["ns", "inum"])?,
    })
}

fn attach(
    ebpf: &mut Ebpf,
    name: &'static str,
    tracepoint: &'static str,
    pins: Option<&Pins>,
) -> Result<Attached, LossesError> {
    let program: Option<&mut RawTracePoint> = ebpf.program_mut(name).and_then(|program| program.try_into().ok());
    let program = program.ok_or(LossesError::NoProgram(name))?;
    let refused = |source| LossesError::Program { tracepoint, source };
    match verified::load(|| program.load()) {
        Err(ProgramError::AlreadyLoaded) | Ok(()) => {}
        Err(error) => return Err(refused(error)),
    }
    let pin = pins.map(|pins| pins.map(tracepoint));
    if let Some(path) = &pin
        && path.exists()
    {
        // A loss between these two steps is not counted. Counting it twice would be worse.
        std::fs::remove_file(path).map_err(|source| LossesError::Unpin { path: path.clone(), source })?;
    }
    let link = program.attach(tracepoint).map_err(refused)?;
    let link: FdLink = program.take_link(link).map_err(refused)?.into();
    Ok(match pin {
        Some(path) => {
            Attached::Pinned { _link: link.pin(path).map_err(|source| LossesError::Pin { tracepoint, source })? }
        }
        None => Attached::Here { _link: link },
    })
}

fn sums(counts: &PerCpuHashMap<MapData, u32, u64>) -> Result<HashMap<u32, u64>, MapError> {
    counts.iter().map(|entry| entry.map(|(ifindex, values)| (ifindex, values.iter().sum()))).collect()
}
