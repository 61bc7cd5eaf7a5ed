//! The default folders of state (keys), of the configuration and of the admin socket, for root and
//! for other users.

use std::os::fd::AsRawFd as _;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, fchown, lchown};
use std::path::{Path, PathBuf};
use std::{fmt, fs, io};

/// The admin socket of a switch that root or the service manager started.
const SYSTEM_SOCKETS: &str = "/run/gdp";

#[derive(Debug)]
pub struct NoFolder;

impl fmt::Display for NoFolder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "no place for the daemon's key and socket: set HOME or XDG_STATE_HOME, or name the files in a \
             configuration",
        )
    }
}

impl std::error::Error for NoFolder {}

/// Returns the effective user of this process.
pub fn user() -> u32 {
    // SAFETY: geteuid has no preconditions and cannot fail.
    unsafe { libc::geteuid() }
}

/// Returns whether this process runs as root.
pub fn is_root() -> bool {
    user() == 0
}

/// Returns the folder of the keys that are generated at first start.
pub fn state() -> Result<PathBuf, NoFolder> {
    if is_root() {
        return Ok("/var/lib/gdp".into());
    }
    let home = || absolute("HOME").map(|home| home.join(".local/state"));
    let base = absolute("XDG_STATE_HOME").or_else(home);
    Ok(base.ok_or(NoFolder)?.join("gdp"))
}

/// Returns the path of the admin socket between daemon and commands. It is beside the keys if the
/// user has no runtime folder.
pub fn admin_socket() -> Result<PathBuf, NoFolder> {
    Ok(sockets()?.join("ctl.sock"))
}

/// Returns the path of the admin socket of the proxy.
pub fn proxy_socket() -> Result<PathBuf, NoFolder> {
    Ok(sockets()?.join("proxy.sock"))
}

fn sockets() -> Result<PathBuf, NoFolder> {
    if is_root() {
        return Ok(SYSTEM_SOCKETS.into());
    }
    let folder = match absolute("XDG_RUNTIME_DIR") {
        Some(base) => base.join("gdp"),
        None => state()?,
    };
    Ok(folder)
}

/// Returns the folder of the user's name cards, grants and key.
pub fn keyring() -> Option<PathBuf> {
    let home = || absolute("HOME").map(|home| home.join(".config"));
    Some(absolute("XDG_CONFIG_HOME").or_else(home)?.join("gdp"))
}

/// Returns the folder of the configuration and keys of this machine: `/etc/gdp`, or for other users
/// the one of their [keyring].
pub fn configuration() -> Option<PathBuf> {
    if is_root() { Some("/etc/gdp".into()) } else { keyring() }
}

/// Returns a variable's path if it is absolute. The XDG base directory specification says to ignore
/// relative paths.
fn absolute(variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute())
}

/// Returns the path of the admin socket for commands: the user's own, or that of the system's
/// switch, if only that one exists.
pub fn admin_socket_for_commands() -> Result<PathBuf, NoFolder> {
    let of_system = Path::new(SYSTEM_SOCKETS).join("ctl.sock");
    match admin_socket() {
        Ok(own) if own.exists() || !of_system.exists() => Ok(own),
        Err(error) if !of_system.exists() => Err(error),
        _ => Ok(of_system),
    }
}

/// Creates a folder as `create_dir_all` does. What root creates inside another user's folder
/// belongs to that user, so that its programs can use it.
pub fn create(folder: &Path) -> io::Result<()> {
    let missing: Vec<_> =
        folder.ancestors().take_while(|path| !path.as_os_str().is_empty() && !path.exists()).collect();
    fs::create_dir_all(folder)?;
    missing.into_iter().rev().try_for_each(give_to_owner_above)
}

/// Gives a file or folder to the owner of the folder that it is in, if this process is root and
/// that owner is not. It does not follow a symbolic link.
pub fn give_to_owner_above(path: &Path) -> io::Result<()> {
    let owner = above(path).metadata()?;
    match is_root() && owner.uid() != 0 {
        true => lchown(path, Some(owner.uid()), Some(owner.gid())),
        false => Ok(()),
    }
}

/// Gives the open file at `path` to the owner of the folder that it is in, as
/// [`give_to_owner_above`] does, whatever the path means now.
pub fn give_file(file: &fs::File, path: &Path) -> io::Result<()> {
    let owner = above(path).metadata()?;
    match is_root() && owner.uid() != 0 {
        true => fchown(file, Some(owner.uid()), Some(owner.gid())),
        false => Ok(()),
    }
}

/// Returns whether this process is root and another user could have put a link at `path`.
pub fn is_foreign_link(path: &Path) -> bool {
    let is_foreign = above(path).metadata().is_ok_and(|above| above.uid() != 0);
    is_root() && is_foreign && path.symlink_metadata().is_ok_and(|found| found.is_symlink())
}

/// Gives `folder` and all below it to the owner of the folder above, if this process is root and
/// that owner is not.
///
/// Files named in `except` stay as they are.
/// That owner may put links into the folder meanwhile. So each owner is set by an open file, links
/// are not followed, and a file with two names is left out.
pub fn give_all(folder: &Path, except: &[&str]) -> io::Result<()> {
    let owner = above(folder).metadata()?;
    if !is_root() || owner.uid() == 0 {
        return Ok(());
    }
    give_opened(folder, except, (owner.uid(), owner.gid()))
}

fn give_opened(path: &Path, except: &[&str], owner: (u32, u32)) -> io::Result<()> {
    let flags = libc::O_NOFOLLOW | libc::O_NONBLOCK | libc::O_CLOEXEC;
    let opened = match fs::OpenOptions::new().read(true).custom_flags(flags).open(path) {
        Ok(opened) => opened,
        // A link, or a socket.
        Err(error) if matches!(error.raw_os_error(), Some(libc::ELOOP | libc::ENXIO)) => return Ok(()),
        Err(error) => return Err(error),
    };
    let found = opened.metadata()?;
    if found.is_dir() {
        // Goes by the open folder, whatever its name means now.
        let inside = PathBuf::from(format!("/proc/self/fd/{}", opened.as_raw_fd()));
        for entry in fs::read_dir(&inside)? {
            let name = entry?.file_name();
            if !except.iter().any(|kept| name == *kept) {
                give_opened(&inside.join(name), except, owner)?;
            }
        }
    }
    match found.is_dir() || found.is_file() && found.nlink() == 1 {
        true => fchown(&opened, Some(owner.0), Some(owner.1)),
        false => Ok(()),
    }
}

fn above(path: &Path) -> &Path {
    path.parent().filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
#[path = "../tests/unit/folders.rs"]
mod tests;
