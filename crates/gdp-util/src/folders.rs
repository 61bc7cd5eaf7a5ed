//! The default folders of state (keys), of the configuration and of the admin socket, for root and
//! for other users.

use std::fmt;
use std::path::PathBuf;

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

/// Returns whether this process runs as root.
pub fn is_root() -> bool {
    // SAFETY: geteuid has no preconditions and cannot fail.
    unsafe { libc::geteuid() == 0 }
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
        return Ok("/run/gdp".into());
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
