//! Kernel settings of interfaces that DPDK uses as devices: changed during use and restored
//! afterwards. With some drivers the kernel also receives all traffic. It would then answer a
//! second time, besides the host's interface of the port. It would also merge packets that DPDK
//! needs as they arrived.
//!
//! A file stores the previous values. If a daemon is killed and cannot restore them, the next
//! daemon does.

use std::fs::{self, DirBuilder, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::PathBuf;

use gdp_link::port::interface_index;

use crate::{device, netlink::Netlink, netlink::number};

/// Settings for every device. The kernel drops packets whose source is not routed by the interface,
/// answers no ARP requests, and disables IPv6.
const QUIET: [(&str, u32); 3] = [("ipv4/rp_filter", 1), ("ipv4/arp_ignore", 8), ("ipv6/disable_ipv6", 1)];

/// Settings that stop the kernel from merging packets: no two packets together fit this size.
/// Disabling GRO entirely would make a veth refuse frames redirected by XDP. Kernels before Linux
/// 6.3 have only the first setting, and kernels before 5.19 have neither. Where both exist, setting
/// the first also sets the second.
const GRO: &str = "gro_max_size";
const GRO_IPV4: &str = "gro_ipv4_max_size";
const NONE_JOINED: u32 = 1;

/// Netlink attributes of these settings, from `linux/if_link.h`.
const LINK: [(&str, u16); 3] = [(MTU, 4), (GRO, 58), (GRO_IPV4, 64)];
const MTU: &str = "mtu";

/// Changed settings. Dropping it restores the previous values.
pub struct Settings {
    changed: Vec<ChangedSetting>,
    file: Option<SettingsFile>,
}

/// The file of changed settings. It stays locked for the lifetime of this value. Another daemon
/// therefore does not mistake it for the file of a killed daemon.
struct SettingsFile {
    path: PathBuf,
    file: File,
}

/// Settings that could not be restored.
#[derive(Default)]
struct Unrestored {
    /// The kernel refused the change.
    refused: Vec<ChangedSetting>,
    /// Number of settings that cannot be read: their interfaces are gone, or in another network
    /// namespace.
    unreadable: usize,
}

/// A changed setting of an interface, with its previous and new value.
#[derive(Clone, Debug, PartialEq, Eq)]
struct ChangedSetting {
    interface: String,
    name: String,
    before: u32,
    set: u32,
}

impl Settings {
    /// Opens the settings in the calling thread's network namespace, where they must also be
    /// dropped. `path`: the file, which may contain settings that a killed daemon did not restore.
    pub fn open(path: Option<PathBuf>) -> Self {
        let open = |path| {
            let (mut file, left) = SettingsFile::open(path)?;
            let lines = left.len();
            let changed = put_back(left).refused;
            // Not where all stay, so that a full disk loses none.
            if changed.len() < lines {
                file.file.set_len(0)?;
                file.file.write_all(changed.iter().map(ChangedSetting::line).collect::<String>().as_bytes())?;
            }
            Ok((changed, file))
        };
        let opened = path.map(open).transpose().inspect_err(|error: &io::Error| {
            tracing::warn!(%error, "if this daemon is killed, settings of interfaces stay changed");
        });
        let (changed, file) = opened.ok().flatten().unzip();
        Self { changed: changed.unwrap_or_default(), file }
    }

    /// Stops the kernel from processing packets that arrive at an interface.
    pub fn quieten(&mut self, interface: &str) {
        for (name, value) in QUIET {
            self.set_if_there(interface, name, value, "the kernel may answer beside DPDK");
        }
    }

    /// Stops the kernel from merging packets that arrive at an interface.
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

    /// Changes a setting if it exists; IPv6 may be absent entirely. `otherwise`: the consequence to
    /// log if the change fails.
    fn set_if_there(&mut self, interface: &str, name: &str, value: u32, otherwise: &'static str) {
        let Ok(before) = read(interface, name) else { return };
        if let Err(error) = self.set(interface, name, before, value) {
            tracing::warn!(interface, name, %error, "{otherwise}");
        }
    }

    fn set(&mut self, interface: &str, name: &str, before: u32, set: u32) -> io::Result<()> {
        let changed = ChangedSetting { interface: interface.to_owned(), name: name.to_owned(), before, set };
        // Write the file first, so that the previous value survives any failure.
        self.file.as_mut().map_or(Ok(()), |file| file.file.write_all(changed.line().as_bytes()))?;
        self.changed.push(changed);
        write(interface, name, set)
    }
}

impl Drop for Settings {
    fn drop(&mut self) {
        if put_back(std::mem::take(&mut self.changed)).refused.is_empty() {
            self.file.iter().for_each(SettingsFile::remove);
        }
    }
}

/// Restores the settings that a killed daemon left in a file. The file remains if any setting could
/// not be restored. The next daemon may succeed in another namespace or with more privileges.
pub fn put_back_left(path: PathBuf) -> io::Result<()> {
    let (file, left) = SettingsFile::open(path)?;
    let left = put_back(left);
    if left.refused.is_empty() && left.unreadable == 0 {
        file.remove();
    }
    Ok(())
}

impl SettingsFile {
    /// Opens or creates the file, and reads its settings.
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

/// Restores settings that no other program has changed since, in reverse order, because a setting
/// may change another. Returns the rest; the refused ones in the given order.
fn put_back(all: Vec<ChangedSetting>) -> Unrestored {
    let now: Vec<_> = all.iter().map(|changed| read(&changed.interface, &changed.name)).collect();
    let mut left = Unrestored::default();
    for (changed, now) in all.into_iter().zip(now).rev() {
        let ChangedSetting { interface, name, before, set } = &changed;
        match now {
            Err(_) => left.unreadable += 1,
            Ok(now) if now != *set => {}
            Ok(_) => {
                if let Err(error) = write(interface, name, *before) {
                    tracing::warn!(interface, name, %error, "a setting stays");
                    left.refused.push(changed);
                }
            }
        }
    }
    left.refused.reverse();
    left
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

/// Returns the file of a setting in this network namespace.
fn file(interface: &str, name: &str) -> io::Result<PathBuf> {
    // The contents of the settings file are not trusted.
    let is_known = QUIET.iter().any(|(known, _)| *known == name);
    let is_one = !interface.contains('/') && !["", ".", ".."].contains(&interface);
    let (family, name) = name.split_once('/').filter(|_| is_known && is_one).ok_or(io::ErrorKind::InvalidInput)?;
    Ok(PathBuf::from(format!("/proc/sys/net/{family}/conf/{interface}/{name}")))
}

#[cfg(test)]
#[path = "../../tests/unit/dpdk/settings.rs"]
mod tests;
