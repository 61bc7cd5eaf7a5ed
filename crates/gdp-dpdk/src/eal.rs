//! DPDK's environment: its memory, its drivers, and the threads that it knows. A process has one,
//! for as long as it lives.

use std::ffi::{CString, c_char};
use std::marker::PhantomData;
use std::sync::mpsc;

use crate::{DpdkError, sys};
use parking_lot::Mutex;

/// How DPDK is to begin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EalConfig {
    /// Where its memory comes from.
    pub memory: Memory,
    /// Addresses of the network cards that it drives by itself, as `lspci -D` has them; the others
    /// it leaves alone.
    pub pci: Vec<String>,
}

/// Where DPDK's memory comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Memory {
    /// Huge pages, as many as are needed. What network cards want that DPDK drives by itself.
    HugePages,
    /// Ordinary pages, of so many MiB.
    Ordinary { mib: u32 },
}

impl Default for EalConfig {
    fn default() -> Self {
        Self { memory: Memory::Ordinary { mib: 256 }, pci: Vec::new() }
    }
}

/// That DPDK has begun. Nothing of it can be used without.
#[derive(Clone, Copy, Debug)]
pub struct Eal(());

/// How it began, if it did. It can begin once in the life of a process, even if it failed.
static BEGUN: Mutex<Option<Result<EalConfig, String>>> = Mutex::new(None);

/// Beginning has failed, or was asked for otherwise.
#[derive(Debug, thiserror::Error)]
pub enum EalError {
    #[error(transparent)]
    Failed(#[from] DpdkError),
    #[error("DPDK has failed to begin before, and a process has one try: {0}")]
    FailedBefore(String),
    #[error("DPDK has begun in this process already, in another way: {0:?}")]
    Otherwise(EalConfig),
    #[error("DPDK takes no address with a null byte in it")]
    Null,
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
}

impl Eal {
    /// Begins, or finds that it has begun in the same way.
    pub fn begin(config: &EalConfig) -> Result<Self, EalError> {
        let mut begun = BEGUN.lock();
        match &*begun {
            Some(Ok(before)) if before == config => return Ok(Self(())),
            Some(Ok(before)) => return Err(EalError::Otherwise(before.clone())),
            Some(Err(error)) => return Err(EalError::FailedBefore(error.clone())),
            None => {}
        }
        let arguments = arguments(config)?;
        let (sender, receiver) = mpsc::channel();
        // The thread that begins is bound to one core from then on, and DPDK keeps it among its
        // own: so it is none of ours.
        let thread = move || {
            let _ = sender.send(init(arguments));
            loop {
                std::thread::park();
            }
        };
        std::thread::Builder::new().name("dpdk-main".into()).spawn(thread).map_err(EalError::Thread)?;
        let result = receiver.recv().unwrap_or_else(|_| Err(DpdkError::new("DPDK's first thread", libc::ESRCH)));
        *begun = Some(result.as_ref().map(|()| config.clone()).map_err(DpdkError::to_string));
        Ok(result.map(|()| Self(()))?)
    }

    /// Makes DPDK know the calling thread, which then has caches of its own for what it allocates.
    pub fn register(self) -> Result<Registered, DpdkError> {
        // SAFETY: of the calling thread, which `Registered` does not leave.
        match unsafe { sys::rte_thread_register() } {
            0 => Ok(Registered(PhantomData)),
            _ => Err(DpdkError::last("DPDK takes no more threads")),
        }
    }
}

/// That DPDK knows this thread. Stays on it.
pub struct Registered(PhantomData<*mut ()>);

impl Drop for Registered {
    fn drop(&mut self) {
        // SAFETY: this thread was registered, and has not left.
        unsafe { sys::rte_thread_unregister() };
    }
}

fn arguments(config: &EalConfig) -> Result<Vec<CString>, EalError> {
    let core = first_core();
    let mut arguments = vec![
        "gdp".to_owned(),
        "--lcores".to_owned(),
        format!("0@{core}"),
        "--no-telemetry".to_owned(),
        format!("--file-prefix=gdp-{}", std::process::id()),
        // Warnings and worse; the rest is noise in a daemon's log.
        "--log-level=5".to_owned(),
    ];
    match config.memory {
        Memory::HugePages => arguments.push("--in-memory".to_owned()),
        // Without files that nobody else reads.
        Memory::Ordinary { mib } => {
            arguments.extend(["--no-huge", "--no-shconf", "-m", &mib.to_string()].map(str::to_owned));
        }
    }
    match &config.pci[..] {
        [] => arguments.push("--no-pci".to_owned()),
        addresses => arguments.extend(addresses.iter().flat_map(|address| ["-a".to_owned(), address.clone()])),
    }
    arguments.into_iter().map(|argument| CString::new(argument).map_err(|_| EalError::Null)).collect()
}

/// The first core that this process may run on; 0 if that cannot be told.
fn first_core() -> usize {
    // SAFETY: a plain set of bits, all of which may be zero, and its size.
    unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        libc::sched_getaffinity(0, size_of::<libc::cpu_set_t>(), &raw mut set);
        (0..libc::CPU_SETSIZE as usize).find(|core| libc::CPU_ISSET(*core, &set)).unwrap_or(0)
    }
}

fn init(arguments: Vec<CString>) -> Result<(), DpdkError> {
    let mut pointers: Vec<*mut c_char> = arguments.iter().map(|argument| argument.as_ptr().cast_mut()).collect();
    // SAFETY: so many strings, which it does not write to; it may reorder the pointers.
    let result = unsafe { sys::rte_eal_init(pointers.len() as i32, pointers.as_mut_ptr()) };
    // It keeps pointers to some of them.
    std::mem::forget(arguments);
    if result < 0 {
        return Err(DpdkError::last("DPDK does not begin")
            .with_remedy("; with huge pages, `sysctl vm.nr_hugepages=256` makes some; its own words are on stderr"));
    }
    Ok(())
}
