//! The default folders of state (keys), of the configuration and of the admin socket, for root and
//! for other users.

use std::fmt;
use std::path::{Path, PathBuf};

use crate::os::{self, is_root};

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

/// Returns the folder of the keys that are generated at first start.
pub fn state() -> Result<PathBuf, NoFolder> {
    if is_root() {
        return Ok("/var/lib/gdp".into());
    }
    Ok(os::state_base().ok_or(NoFolder)?.join("gdp"))
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
    let folder = match os::runtime_base() {
        Some(base) => base.join("gdp"),
        None => state()?,
    };
    Ok(folder)
}

/// Returns the folder of the user's name cards, grants and key.
pub fn keyring() -> Option<PathBuf> {
    Some(os::configuration_base()?.join("gdp"))
}

/// Returns the folder of the configuration and keys of this machine: `/etc/gdp`, or for other users
/// the one of their [keyring].
pub fn configuration() -> Option<PathBuf> {
    if is_root() { Some("/etc/gdp".into()) } else { keyring() }
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
