//! Counts the frames that a redirect loses after the switch has decided: loads the programs of the
//! eBPF object that listen to the kernel's tracepoints, says which interfaces they watch, reads
//! what they count. What the counts mean is at [`gdp_wire::Counter::RedirectLost`]. Part of
//! [`super::kernel`].
//!
//! What they cannot see: frames that an interface took and lost later (the ring of a veth whose
//! other end goes down), and packets that generic XDP sends, which are like any other packet of the
//! host (`ip -s link`, `dropped`).

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

/// The map in the object, and in a folder of pins.
pub const MAP: &str = "REDIRECT_LOSSES";

/// The global of the object that says where to look.
pub const WHERE: &str = "NET_DEVICES";

/// Programs of the object and the tracepoints they are for.
const PROGRAMS: [(&str, &str); 2] = [("gdp_devmap_xmit", "xdp_devmap_xmit"), ("gdp_redirect_err", "xdp_redirect_err")];

/// Why losses are not counted, or not all.
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

/// What is lost on the way to the interfaces of a switch.
pub struct Losses {
    counts: PerCpuHashMap<MapData, u32, u64>,
    /// Whoever lets go of them detaches the programs, unless they are pinned.
    programs: Vec<Attached>,
}

enum Attached {
    Here { _link: FdLink },
    Pinned { _link: PinnedLink },
}

impl Losses {
    /// Of the object's map; nothing is counted yet.
    pub fn new(counts: PerCpuHashMap<MapData, u32, u64>) -> Self {
        Self { counts, programs: Vec::new() }
    }

    /// Has the programs listen; those that an earlier daemon has left are replaced. For one that
    /// was loaded with [`net_devices`].
    pub fn start(&mut self, ebpf: &mut Ebpf, pins: Option<&Pins>) -> Result<(), LossesError> {
        if !self.programs.is_empty() {
            return Ok(());
        }
        let attached = PROGRAMS.map(|(program, tracepoint)| attach(ebpf, program, tracepoint, pins));
        self.programs = attached.into_iter().collect::<Result<_, _>>()?;
        Ok(())
    }

    /// Counts for these interfaces, and no others, from now on; what was counted for one that
    /// stays, stays.
    pub fn watch(&mut self, interfaces: &[u32]) -> Result<(), LossesError> {
        let known: Vec<u32> = self.counts.keys().collect::<Result<_, _>>()?;
        known.iter().filter(|known| !interfaces.contains(known)).try_for_each(|gone| self.counts.remove(gone))?;
        for new in interfaces.iter().filter(|new| !known.contains(new)) {
            let cpus = util::nr_cpus().map_err(|(_, source)| MapError::IoError(source))?;
            self.counts.insert(new, PerCpuValues::try_from(vec![0; cpus]).map_err(MapError::IoError)?, 0)?;
        }
        Ok(())
    }

    /// Frames lost so far, by interface.
    pub fn counts(&self) -> Result<HashMap<u32, u64>, MapError> {
        sums(&self.counts)
    }
}

/// Frames lost so far by interface, from a folder of pins. None if a daemon has left it that did
/// not count them.
pub fn pinned_counts(folder: &Path) -> Result<HashMap<u32, u64>, MapError> {
    let path = folder.join(MAP);
    if !path.exists() {
        return Ok(HashMap::new());
    }
    sums(&PerCpuHashMap::try_from(aya::maps::Map::PerCpuHashMap(MapData::from_pin(path)?))?)
}

/// Where the programs find interface and namespace in this kernel, for the namespace of the calling
/// thread.
pub fn net_devices() -> Result<NetDevices, LossesError> {
    let types = KernelTypes::load(Path::new(VMLINUX))?;
    let namespace = std::fs::metadata("/proc/thread-self/ns/net").map_err(LossesError::Namespace)?;
    Ok(NetDevices {
        // The kernel has 32 bits of it.
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
        // A loss between these two steps is not counted; twice would be worse.
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
