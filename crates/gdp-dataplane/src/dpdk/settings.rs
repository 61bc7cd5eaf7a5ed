//! Settings of the kernel's that are others while DPDK has an interface as a device, and put back
//! afterwards. With some drivers the kernel gets all that arrives as well, and would answer twice,
//! on the host's side of the port and here; and it would join packets that DPDK is to have as they
//! came.
//!
//! What was there before is kept in a file as well: a daemon that is killed puts nothing back, so
//! the next one does.

use std::fs::{self, DirBuilder, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::PathBuf;

use gdp_link::port::interface_index;

use crate::{device, netlink::Netlink, netlink::number};

/// What is set for every device: a packet whose sender is not reached by the interface is not for
/// this host, no address is answered for, and IPv6 is off.
const QUIET: [(&str, u32); 3] = [("ipv4/rp_filter", 1), ("ipv4/arp_ignore", 8), ("ipv6/disable_ipv6", 1)];

/// What is set where packets are to come one by one: no two are as short as that together. To turn
/// joining (GRO) off as a whole would have a veth refuse what XDP redirects to it. Older kernels
/// have only the first one (before Linux 6.3), or neither (before 5.19); where there are both,
/// setting the first sets both.
const GRO: &str = "gro_max_size";
const GRO_IPV4: &str = "gro_ipv4_max_size";
const NONE_JOINED: u32 = 1;

/// What netlink calls them; `linux/if_link.h`.
const LINK: [(&str, u16); 3] = [(MTU, 4), (GRO, 58), (GRO_IPV4, 64)];
const MTU: &str = "mtu";

/// Settings that were changed. When dropped, all is as it was.
pub struct Settings {
    changed: Vec<ChangedSetting>,
    file: Option<SettingsFile>,
}

/// The file. It is locked for as long as this lives, so that no other daemon takes it for what a
/// dead one has left.
struct SettingsFile {
    path: PathBuf,
    file: File,
}

/// A setting of an interface, as it was and as it was set.
#[derive(Clone, Debug, PartialEq, Eq)]
struct ChangedSetting {
    interface: String,
    name: String,
    before: u32,
    set: u32,
}

impl Settings {
    /// In the network namespace of the calling thread, in which it is to be dropped as well.
    /// `path`: of the file, in which there may be what a daemon that was killed has not put back.
    pub fn open(path: Option<PathBuf>) -> Self {
        let open = |path| {
            let (file, left) = SettingsFile::open(path)?;
            put_back(&left);
            file.file.set_len(0)?;
            Ok(file)
        };
        let file = path.map(open).transpose().inspect_err(|error: &io::Error| {
            tracing::warn!(%error, "if this daemon is killed, settings of interfaces stay changed");
        });
        Self { changed: Vec::new(), file: file.ok().flatten() }
    }

    /// Keeps the kernel from taking up what arrives at an interface.
    pub fn quieten(&mut self, interface: &str) {
        for (name, value) in QUIET {
            self.set_if_there(interface, name, value, "the kernel may answer beside DPDK");
        }
    }

    /// Keeps the kernel from joining packets that arrive at an interface.
    pub fn keep_whole(&mut self, interface: &str) {
        let otherwise = "the kernel joins packets, and TCP to this host is slow unless GRO is off";
        if let Err(error) = read(interface, GRO) {
            tracing::warn!(interface, %error, "{otherwise}");
        }
        for name in [GRO_IPV4, GRO] {
            self.set_if_there(interface, name, NONE_JOINED, otherwise);
        }
    }

    pub fn set_mtu(&mut self, interface: &str, mtu: u16) -> io::Result<()> {
        let before = read(interface, MTU)?;
        self.set(interface, MTU, before, mtu.into())
    }

    /// `otherwise`: what happens if it cannot be set. What is not there needs no setting: IPv6 may
    /// be missing as a whole.
    fn set_if_there(&mut self, interface: &str, name: &str, value: u32, otherwise: &'static str) {
        let Ok(before) = read(interface, name) else { return };
        if let Err(error) = self.set(interface, name, before, value) {
            tracing::warn!(interface, name, %error, "{otherwise}");
        }
    }

    fn set(&mut self, interface: &str, name: &str, before: u32, set: u32) -> io::Result<()> {
        let changed = ChangedSetting { interface: interface.to_owned(), name: name.to_owned(), before, set };
        // First, so that it is there however this ends.
        self.file.as_mut().map_or(Ok(()), |file| file.file.write_all(changed.line().as_bytes()))?;
        self.changed.push(changed);
        write(interface, name, set)
    }
}

impl Drop for Settings {
    fn drop(&mut self) {
        put_back(&self.changed);
        self.file.iter().for_each(SettingsFile::remove);
    }
}

/// Puts back what a daemon that was killed has left in a file. The file stays if not all
/// could be: in another namespace, or with more rights, the next daemon may do better.
pub fn put_back_left(path: PathBuf) -> io::Result<()> {
    let (file, left) = SettingsFile::open(path)?;
    if put_back(&left) {
        file.remove();
    }
    Ok(())
}

impl SettingsFile {
    /// Makes the file if there is none, and reads what is in it.
    fn open(path: PathBuf) -> io::Result<(Self, Vec<ChangedSetting>)> {
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        }
        let mut options = File::options();
        options.read(true).append(true).create(true).mode(0o600).custom_flags(libc::O_NOFOLLOW);
        let mut file = options.open(&path)?;
        file.try_lock()?;
        let mut left = String::new();
        file.read_to_string(&mut left)?;
        let left = left.lines().filter_map(ChangedSetting::parse).collect();
        Ok((Self { path, file }, left))
    }

    fn remove(&self) {
        if let Err(error) = fs::remove_file(&self.path) {
            tracing::debug!(path = %self.path.display(), %error, "the file of settings stays");
        }
    }
}

impl ChangedSetting {
    fn line(&self) -> String {
        format!("{} {} {} {}\n", self.interface, self.name, self.before, self.set)
    }

    fn parse(line: &str) -> Option<Self> {
        let [interface, name, before, set] = line.split(' ').collect::<Vec<_>>().try_into().ok()?;
        let (before, set) = (before.parse().ok()?, set.parse().ok()?);
        Some(Self { interface: interface.to_owned(), name: name.to_owned(), before, set })
    }
}

/// What nobody else has set since; the last one first: one may set another as well. Whether that is
/// all.
fn put_back(all: &[ChangedSetting]) -> bool {
    let now: Vec<_> = all.iter().map(|changed| read(&changed.interface, &changed.name)).collect();
    let mut is_all = now.iter().all(Result::is_ok);
    let ours = all.iter().zip(now).filter(|(changed, now)| now.as_ref().is_ok_and(|now| *now == changed.set));
    for (ChangedSetting { interface, name, before, .. }, _) in ours.rev() {
        if let Err(error) = write(interface, name, *before) {
            tracing::warn!(interface, name, %error, "a setting stays");
            is_all = false;
        }
    }
    is_all
}

fn read(interface: &str, name: &str) -> io::Result<u32> {
    match by_netlink(name) {
        Some(attribute) => {
            let answer = device::ask(interface_index(interface)?)?;
            number(answer.get(device::HEADER..).unwrap_or_default(), attribute).ok_or(io::ErrorKind::Unsupported.into())
        }
        None => {
            fs::read_to_string(file(interface, name)?)?.trim().parse().map_err(|_| io::ErrorKind::InvalidData.into())
        }
    }
}

fn write(interface: &str, name: &str, value: u32) -> io::Result<()> {
    match by_netlink(name) {
        Some(attribute) => {
            let attributes = [(attribute, &value.to_ne_bytes()[..])];
            let header = device::header(interface_index(interface)?);
            Netlink::open(libc::NETLINK_ROUTE)?.change(libc::RTM_SETLINK, &header, &attributes)
        }
        None => fs::write(file(interface, name)?, value.to_string()),
    }
}

fn by_netlink(name: &str) -> Option<u16> {
    LINK.iter().find(|(known, _)| *known == name).map(|(_, attribute)| *attribute)
}

/// Of this network namespace.
fn file(interface: &str, name: &str) -> io::Result<PathBuf> {
    // What a file says may be anything.
    let is_known = QUIET.iter().any(|(known, _)| *known == name);
    let is_one = !interface.contains('/') && !["", ".", ".."].contains(&interface);
    let (family, name) = name.split_once('/').filter(|_| is_known && is_one).ok_or(io::ErrorKind::InvalidInput)?;
    Ok(PathBuf::from(format!("/proc/sys/net/{family}/conf/{interface}/{name}")))
}

#[cfg(test)]
#[path = "../../tests/unit/dpdk/settings.rs"]
mod tests;
