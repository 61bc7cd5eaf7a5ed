//! Linux capabilities (capabilities(7)): the capabilities that a switch needs, those of the calling
//! thread, and dropping the others.
//!
//! Capabilities belong to threads. A new thread inherits those of the thread that starts it.

use std::io;

/// A capability, as defined in `linux/capability.h`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capability {
    pub name: &'static str,
    number: u32,
}

const fn capability(name: &'static str, number: u32) -> Capability {
    Capability { name, number }
}

pub const NET_BIND_SERVICE: Capability = capability("CAP_NET_BIND_SERVICE", 10);
const NET_ADMIN: Capability = capability("CAP_NET_ADMIN", 12);
const NET_RAW: Capability = capability("CAP_NET_RAW", 13);
pub const SYS_ADMIN: Capability = capability("CAP_SYS_ADMIN", 21);
const PERFMON: Capability = capability("CAP_PERFMON", 38);
const BPF: Capability = capability("CAP_BPF", 39);

/// Needed for maps and programs, for arithmetic on packet pointers, and to attach programs.
pub const XDP: [Capability; 3] = [BPF, PERFMON, NET_ADMIN];

/// Needed for XDP, and for the packet sockets of links on Ethernet.
pub const SWITCH: [Capability; 4] = [BPF, PERFMON, NET_ADMIN, NET_RAW];

/// Returns the capabilities that the calling thread lacks. CAP_SYS_ADMIN includes CAP_BPF and
/// CAP_PERFMON.
pub fn missing(wanted: &[Capability]) -> Vec<&'static str> {
    let effective = Sets::read().map_or(0, |sets| sets.effective);
    wanted.iter().filter(|wanted| !includes(effective, **wanted)).map(|wanted| wanted.name).collect()
}

/// Permanently drops all capabilities except `keep`, for the calling thread and every program that
/// it runs. The calling thread must be the only thread. Capabilities that the thread lacks are not
/// added.
pub fn keep_only(keep: &[Capability]) -> io::Result<()> {
    let permitted = Sets::read()?.permitted;
    let mut kept = keep.iter().fold(0, |kept, capability| kept | bit(*capability)) & permitted;
    if keep.iter().any(|wanted| kept & bit(*wanted) == 0 && includes(permitted, *wanted)) {
        kept |= bit(SYS_ADMIN);
    }
    for number in (0..u64::BITS).filter(|number| kept & 1 << number == 0) {
        // This fails without CAP_SETPCAP. `no_new_privs` then still stops programs from gaining
        // capabilities.
        // SAFETY: the arguments are plain numbers.
        unsafe { libc::prctl(libc::PR_CAPBSET_DROP, libc::c_ulong::from(number), 0, 0, 0) };
    }
    Sets { effective: kept, permitted: kept }.write()?;
    // SAFETY: the arguments are plain numbers.
    match unsafe { libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

fn includes(set: u64, capability: Capability) -> bool {
    let by_admin = [BPF, PERFMON].contains(&capability);
    set & bit(capability) != 0 || by_admin && set & bit(SYS_ADMIN) != 0
}

fn bit(capability: Capability) -> u64 {
    1 << capability.number
}

/// Capability sets of the calling thread.
#[derive(Clone, Copy)]
struct Sets {
    effective: u64,
    permitted: u64,
}

/// `__user_cap_header_struct`
#[repr(C)]
struct CapHeader {
    version: u32,
    pid: libc::c_int,
}

/// `__user_cap_data_struct`: 32 bits of each set.
#[repr(C)]
#[derive(Clone, Copy, Default)]
struct CapWords {
    effective: u32,
    permitted: u32,
    inheritable: u32,
}

impl Sets {
    fn read() -> io::Result<Self> {
        let (mut header, mut words) = (header(), [CapWords::default(); 2]);
        // SAFETY: these are the structures of version 3, which the kernel reads and writes during
        // the call.
        let result = unsafe { libc::syscall(libc::SYS_capget, &raw mut header, words.as_mut_ptr()) };
        let whole = |low: u32, high: u32| u64::from(high) << 32 | u64::from(low);
        match (result, words) {
            (0, [low, high]) => Ok(Self {
                effective: whole(low.effective, high.effective),
                permitted: whole(low.permitted, high.permitted),
            }),
            _ => Err(io::Error::last_os_error()),
        }
    }

    /// Sets the capabilities. The inheritable set is empty, which also clears ambient capabilities.
    fn write(self) -> io::Result<()> {
        let mut header = header();
        let words = [0, 32].map(|shift| CapWords {
            effective: (self.effective >> shift) as u32,
            permitted: (self.permitted >> shift) as u32,
            inheritable: 0,
        });
        // SAFETY: these are the structures of version 3, which the kernel reads during the call.
        match unsafe { libc::syscall(libc::SYS_capset, &raw mut header, words.as_ptr()) } {
            0 => Ok(()),
            _ => Err(io::Error::last_os_error()),
        }
    }
}

fn header() -> CapHeader {
    /// Version with two words for each set.
    const VERSION_3: u32 = 0x2008_0522;
    CapHeader { version: VERSION_3, pid: 0 }
}

#[cfg(test)]
#[path = "../tests/unit/capabilities.rs"]
mod tests;
