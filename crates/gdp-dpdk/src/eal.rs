//! DPDK's environment: its memory, its drivers, and the threads registered with it. A process has
//! one environment for its lifetime.

use std::ffi::{CString, c_char};
use std::marker::PhantomData;
use std::sync::mpsc;

use crate::{DpdkError, sys};
use parking_lot::Mutex;

/// Configuration of DPDK.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EalConfig {
    /// Source of DPDK's memory.
    pub memory: Memory,
    /// PCI addresses of the network cards that DPDK drives itself, as in `lspci -D`. DPDK ignores
    /// all other cards.
    pub pci: Vec<String>,
}

/// Source of DPDK's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Memory {
    /// Huge pages, as many as necessary. Network cards that DPDK drives itself need them.
    HugePages,
    /// Ordinary pages of this total size in MiB.
    Ordinary { mib: u32 },
}

impl Default for EalConfig {
    fn default() -> Self {
        Self { memory: Memory::Ordinary { mib: 256 }, pci: Vec::new() }
    }
}

/// Proof that DPDK is initialized. Every use of DPDK requires it.
#[derive(Clone, Copy, Debug)]
pub struct Eal(());

/// Configuration or error of the initialization. A process can initialize DPDK only once, even if
/// it fails.
static BEGUN: Mutex<Option<Result<EalConfig, String>>> = Mutex::new(None);

/// The initialization failed, or an earlier initialization had a different configuration.
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
    /// Initializes DPDK, or returns the existing environment if its configuration is the same.
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
        // DPDK binds the initializing thread to one core and registers it. Use a separate thread
        // for this.
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

    /// Registers the calling thread with DPDK, which gives it its own allocation caches.
    pub fn register(self) -> Result<Registered, DpdkError> {
        // SAFETY: the call registers the calling thread, and `Registered` stays on this thread.
        match unsafe { sys::rte_thread_register() } {
            0 => Ok(Registered(PhantomData)),
            _ => Err(DpdkError::last("DPDK takes no more threads")),
        }
    }
}

/// Registration of this thread with DPDK. It cannot move to another thread.
pub struct Registered(PhantomData<*mut ()>);

impl Drop for Registered {
    fn drop(&mut self) {
        // SAFETY: this thread was registered, and the value has not left it.
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
        // Log only warnings and errors.
        "--log-level=5".to_owned(),
    ];
    match config.memory {
        Memory::HugePages => arguments.push("--in-memory".to_owned()),
        // Create no files for other processes.
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

/// Returns the first core that this process may run on, or 0 if it is unknown.
fn first_core() -> usize {
    // SAFETY: the set has only plain bits, which may all be zero, and the size matches.
    unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        libc::sched_getaffinity(0, size_of::<libc::cpu_set_t>(), &raw mut set);
        (0..libc::CPU_SETSIZE as usize).find(|core| libc::CPU_ISSET(*core, &set)).unwrap_or(0)
    }
}

fn init(arguments: Vec<CString>) -> Result<(), DpdkError> {
    let mut pointers: Vec<*mut c_char> = arguments.iter().map(|argument| argument.as_ptr().cast_mut()).collect();
    // SAFETY: the array has this number of strings. DPDK does not write to them, but may reorder
    // the pointers.
    let result = unsafe { sys::rte_eal_init(pointers.len() as i32, pointers.as_mut_ptr()) };
    // DPDK retains pointers to some of them.
    std::mem::forget(arguments);
    if result < 0 {
        return Err(DpdkError::last("DPDK does not begin")
            .with_remedy("; with huge pages, `sysctl vm.nr_hugepages=256` makes some; its own words are on stderr"));
    }
    Ok(())
}
