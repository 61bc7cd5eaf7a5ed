//! State of a switch that outlives its daemon: BPF maps and XDP links, pinned in a BPF file system:
//!
//! ```text
//!  BPFFS/gdp/v1/75e1….-4026531840/LINKS, FIB, …      the maps, by name
//!             │ │      │          /GROUP-3            the device map of group 3
//!             │ │      │          /xdp-7-native       the program on interface 7
//!             │ │      └ network namespace
//!             │ └ switch, 16 digits
//!             └ version of the maps (gdp_wire::table::ABI)
//! ```
//!
//! The process that has locked the folder owns the switch. A daemon locks it for its lifetime,
//! `gdp-ctl xdp detach` only while it runs. The kernel releases the lock when the process ends for
//! any reason. This module handles only files and their layout; [`super::kernel`] writes the maps.
//! [`super::kernel`], [`crate::Planes`] and the command line call it.

use std::ffi::CString;
use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use aya::maps::{MapError, MapInfo};
use gdp_wire::Name;
use gdp_wire::table::ABI;

use crate::attach_mode::Mode;

/// Default mount point of the BPF file system.
pub const BPFFS: &str = "/sys/fs/bpf";

const THIS_NAMESPACE: &str = "/proc/thread-self/ns/net";

/// Folder of this project in the BPF file system.
const FOLDER: &str = "gdp";

/// Folder of the service's switch. Its user sees it as the root of the BPF file system, because
/// only root may enter that.
const OF_SERVICE: &str = "gdp-switch";

/// Reasons why the pins of a switch cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PinsError {
    #[error("no BPF file system at {}: {reason}", path.display())]
    NoBpffs { path: PathBuf, reason: String },
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error("another daemon runs this switch in this network namespace (it has locked {}); stop it \
             first", .0.display())]
    InUse(PathBuf),
    #[error(
        "the kernel still forwards by what a daemon of another version left at {}; `gdp-ctl xdp detach` removes it, \
         and frames stop until a daemon runs again",
        .0.display()
    )]
    OtherAbi(PathBuf),
    #[error(
        "{}: its {what} is {found}, and this daemon needs {wanted}; `gdp-ctl xdp detach` removes what the last \
         daemon left, and frames stop until one runs again",
        path.display()
    )]
    Layout { path: PathBuf, what: &'static str, found: u32, wanted: u32 },
    #[error("{}: {source}", path.display())]
    Map { path: PathBuf, source: MapError },
    #[error(
        "{}: it does not hold a FIB; `gdp-ctl xdp detach` removes what the last daemon left, and frames stop until \
         one runs again",
        .0.display()
    )]
    NotAFib(PathBuf),
}

impl PinsError {
    /// Returns whether a daemon can run without pins, losing only the ability to survive a restart.
    /// For every other error, another program already forwards.
    pub fn is_bearable(&self) -> bool {
        matches!(self, Self::NoBpffs { .. } | Self::Io { .. })
    }
}

/// Location of a switch's pins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PinLocation {
    pub bpffs: PathBuf,
    pub switch: Name,
    /// Whether pins of another version of this switch are removed. Otherwise they are an error.
    pub replaces: bool,
}

/// The pins of one switch, locked.
#[derive(Debug)]
pub struct Pins {
    folder: PathBuf,
    lock: File,
}

impl Drop for Pins {
    /// Unlocks explicitly. A child process that is being started shares the descriptor until it
    /// calls exec. If this process only closed its own copy, the child would retain the lock.
    fn drop(&mut self) {
        let _ = self.lock.unlock();
    }
}

/// A folder of pins of any switch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    pub folder: PathBuf,
    /// Version of the maps in the folder.
    pub abi: u32,
    /// First digits of the switch's name.
    pub switch: String,
    /// Inode number of the network namespace.
    pub namespace: u64,
}

impl Pins {
    /// Opens the pins of a switch in the calling thread's network namespace, creating the folder if
    /// necessary. Mounts the file system if it is missing.
    pub fn open(PinLocation { bpffs, switch, replaces }: &PinLocation) -> Result<Self, PinsError> {
        mount(bpffs)?;
        let namespace = this_namespace().map_err(|source| PinsError::Io { path: THIS_NAMESPACE.into(), source })?;
        let digits = &switch.to_string()[..16];
        let mut ours = find(bpffs)?;
        ours.retain(|found| (found.switch.as_str(), found.namespace) == (digits, namespace));
        remove_other_versions(&ours, *replaces)?;
        let folder = bpffs.join(FOLDER).join(format!("v{ABI}")).join(format!("{digits}-{namespace}"));
        fs::DirBuilder::new().recursive(true).mode(0o700).create(&folder).map_err(io_at(&folder))?;
        Self::lock(folder)
    }

    /// Opens a folder that [`find`] returned, to manage it without its daemon.
    pub fn of(found: &Found) -> Result<Self, PinsError> {
        Self::lock(found.folder.clone())
    }

    fn lock(folder: PathBuf) -> Result<Self, PinsError> {
        let file = File::open(&folder).map_err(io_at(&folder))?;
        match file.try_lock() {
            Ok(()) => Ok(Self { folder, lock: file }),
            Err(TryLockError::WouldBlock) => Err(PinsError::InUse(folder)),
            Err(TryLockError::Error(source)) => Err(PinsError::Io { path: folder, source }),
        }
    }

    /// Returns the folder of the pins.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub fn map(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    pub fn link(&self, ifindex: u32, mode: Mode) -> PathBuf {
        self.folder.join(format!("xdp-{ifindex}-{}", mode.as_str()))
    }

    /// Returns the interfaces with a pinned program, and the attach mode of each.
    pub fn links(&self) -> Vec<(u32, Mode)> {
        links(&self.folder)
    }

    /// Returns whether an earlier daemon has left pins.
    pub fn any(&self) -> bool {
        !entries(&self.folder).is_empty()
    }

    /// Compares a pinned map with `wanted`. A map that is not pinned passes.
    pub fn check(&self, name: &str, wanted: &aya_obj::Map, max_entries: u32) -> Result<(), PinsError> {
        // The kernel sets this flag on device maps.
        const READ_ONLY_FOR_PROGRAMS: u32 = 1 << 7;
        let path = self.map(name);
        if !path.exists() {
            return Ok(());
        }
        let broken = |source| PinsError::Map { path: path.clone(), source };
        let info = MapInfo::from_pin(&path).map_err(broken)?;
        let map_type = info.map_type().map_err(broken)? as u32;
        let facts = [
            ("type", map_type, wanted.map_type()),
            ("key size", info.key_size(), wanted.key_size()),
            ("value size", info.value_size(), wanted.value_size()),
            ("capacity", info.max_entries(), max_entries),
            ("set of flags", info.map_flags() & !READ_ONLY_FOR_PROGRAMS, wanted.map_flags() & !READ_ONLY_FOR_PROGRAMS),
        ];
        match facts.into_iter().find(|(_, found, wanted)| found != wanted) {
            Some((what, found, wanted)) => Err(PinsError::Layout { path, what, found, wanted }),
            None => Ok(()),
        }
    }

    /// Removes all pins. The kernel then detaches programs and frees maps that have no other
    /// reference.
    pub fn remove(&self) -> Result<(), PinsError> {
        let mut entries = entries(&self.folder);
        // Remove programs first: no program may run after some of its maps' pins are removed.
        entries.sort_by_key(|path| link_of(path).is_none());
        entries.iter().try_for_each(|path| fs::remove_file(path).map_err(io_at(path)))?;
        fs::remove_dir(&self.folder).map_err(io_at(&self.folder))
    }
}

impl Found {
    /// Returns whether the pins belong to the calling thread's network namespace.
    pub fn is_of_this_namespace(&self) -> bool {
        this_namespace().is_ok_and(|namespace| namespace == self.namespace)
    }

    pub fn links(&self) -> Vec<(u32, Mode)> {
        links(&self.folder)
    }
}

/// Returns all pins of any version in a fixed order. The list is empty if there is no BPF file
/// system.
pub fn find(bpffs: &Path) -> Result<Vec<Found>, PinsError> {
    let mut found = Vec::new();
    let roots = [bpffs.join(FOLDER), bpffs.join(OF_SERVICE).join(FOLDER)];
    for version in roots.iter().flat_map(|root| entries(root)) {
        let Some(abi) = file_name(&version).strip_prefix('v').and_then(|abi| abi.parse().ok()) else { continue };
        for folder in entries(&version) {
            let name = file_name(&folder);
            let Some((switch, namespace)) = name.split_once('-') else { continue };
            let Ok(namespace) = namespace.parse() else { continue };
            // Skip empty folders, which contain no pins.
            if !entries(&folder).is_empty() {
                found.push(Found { switch: switch.to_owned(), folder: folder.clone(), abi, namespace });
            }
        }
    }
    Ok(found)
}

/// Removes a switch's pins of other versions, and with them the programs that forward by them. The
/// kernel would otherwise forward by them for ever, because no daemon of this version can take them
/// over. Fails if `replaces` is false, or if the daemon of such pins runs.
fn remove_other_versions(ours: &[Found], replaces: bool) -> Result<(), PinsError> {
    for other in ours.iter().filter(|found| found.abi != ABI) {
        if !replaces {
            return Err(PinsError::OtherAbi(other.folder.clone()));
        }
        Pins::of(other)?.remove()?;
        tracing::warn!(
            folder = %other.folder.display(),
            "the daemon before this one had another version of the kernel's maps; they are removed, and frames stop \
             until this daemon forwards"
        );
    }
    Ok(())
}

/// Returns the inode number of the calling thread's network namespace.
fn this_namespace() -> io::Result<u64> {
    fs::metadata(THIS_NAMESPACE).map(|namespace| namespace.ino())
}

/// Returns whether a BPF file system is mounted at this path.
pub fn is_mounted(at: &Path) -> bool {
    CString::new(at.as_os_str().as_bytes()).is_ok_and(|path| is_bpffs(&path))
}

/// Mounts a BPF file system unless there is one. Mounting needs CAP_SYS_ADMIN.
pub fn mount(at: &Path) -> Result<(), PinsError> {
    let missing = |reason: String| PinsError::NoBpffs { path: at.into(), reason };
    let path = CString::new(at.as_os_str().as_bytes()).map_err(|_| missing("no path has a NUL in it".into()))?;
    if is_bpffs(&path) {
        return Ok(());
    }
    if !entries(at).is_empty() {
        return Err(missing("there is something else; name another folder as `bpffs`".into()));
    }
    fs::DirBuilder::new().recursive(true).mode(0o700).create(at).map_err(|error| missing(error.to_string()))?;
    // The lock lets only one of several starting daemons mount the file system. A second mount
    // would hide the pins of the first.
    let folder = File::open(at).map_err(|error| missing(error.to_string()))?;
    folder.lock().map_err(|error| missing(format!("it cannot be locked: {error}")))?;
    if is_bpffs(&path) {
        return Ok(());
    }
    // SAFETY: all four C strings outlive the call. The file system reads its options as a C string.
    let result = unsafe {
        libc::mount(c"bpf".as_ptr(), path.as_ptr(), c"bpf".as_ptr(), libc::MS_NOSUID, c"mode=0700".as_ptr().cast())
    };
    match result {
        0 => Ok(()),
        _ => Err(missing(format!(
            "it cannot be mounted: {}; `mount -t bpf bpf {}` as root does it",
            io::Error::last_os_error(),
            at.display()
        ))),
    }
}

fn is_bpffs(path: &CString) -> bool {
    // SAFETY: zero is a valid value of this structure of integers.
    let mut found: libc::statfs = unsafe { std::mem::zeroed() };
    // SAFETY: a C string and a structure that both outlive the call.
    let result = unsafe { libc::statfs(path.as_ptr(), &raw mut found) };
    result == 0 && found.f_type as u64 == libc::BPF_FS_MAGIC as u64
}

fn links(folder: &Path) -> Vec<(u32, Mode)> {
    entries(folder).iter().filter_map(|path| link_of(path)).collect()
}

fn link_of(path: &Path) -> Option<(u32, Mode)> {
    let (ifindex, mode) = file_name(path).strip_prefix("xdp-")?.split_once('-')?;
    let mode = [Mode::Native, Mode::Generic].into_iter().find(|m| m.as_str() == mode)?;
    Some((ifindex.parse().ok()?, mode))
}

/// Returns the sorted contents of a folder, or an empty list if the folder does not exist.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    paths.sort();
    paths
}

fn file_name(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).unwrap_or_default()
}

fn io_at(path: &Path) -> impl Fn(io::Error) -> PinsError {
    move |source| PinsError::Io { path: path.into(), source }
}

#[cfg(test)]
#[path = "../tests/unit/pins.rs"]
mod tests;
