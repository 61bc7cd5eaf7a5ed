//! Where files are when nobody says: state (keys) and the admin socket, for root and for others.

use std::path::PathBuf;

#[derive(Debug, thiserror::Error)]
#[error("no place for the daemon's key and socket: set HOME or XDG_STATE_HOME, or name the files in a configuration")]
pub struct NoFolder;

/// Whether this process may do what only root may.
pub fn is_root() -> bool {
    // SAFETY: geteuid has no preconditions and cannot fail.
    unsafe { libc::geteuid() == 0 }
}

/// The folder of keys that are made at first start.
pub fn state() -> Result<PathBuf, NoFolder> {
    if is_root() {
        return Ok("/var/lib/gdp".into());
    }
    let home = || absolute("HOME").map(|home| home.join(".local/state"));
    let base = absolute("XDG_STATE_HOME").or_else(home);
    Ok(base.ok_or(NoFolder)?.join("gdp"))
}

/// The admin socket that daemon and commands meet at. Beside the keys for a user without a folder
/// for sockets.
pub fn admin_socket() -> Result<PathBuf, NoFolder> {
    if is_root() {
        return Ok("/run/gdp/ctl.sock".into());
    }
    let folder = match absolute("XDG_RUNTIME_DIR") {
        Some(base) => base.join("gdp"),
        None => state()?,
    };
    Ok(folder.join("ctl.sock"))
}

/// The user's name cards, grants and key.
pub fn keyring() -> Option<PathBuf> {
    let home = || absolute("HOME").map(|home| home.join(".config"));
    Some(absolute("XDG_CONFIG_HOME").or_else(home)?.join("gdp"))
}

/// A relative path in these variables is invalid and to be ignored (XDG base directory
/// specification).
fn absolute(variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute())
}
