//! Where files are when nobody says: state (keys) and the admin socket, for root and for others.

use std::path::PathBuf;

#[derive(Debug, thiserror::Error)]
#[error("no place for {what}: set {variable}, or name the file in the configuration")]
pub struct NoFolder {
    what: &'static str,
    variable: &'static str,
}

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
    Ok(base.ok_or(NoFolder { what: "the daemon's key", variable: "XDG_STATE_HOME" })?.join("gdp"))
}

/// The admin socket that daemon and commands meet at.
pub fn admin_socket() -> Result<PathBuf, NoFolder> {
    let base = if is_root() { Some("/run".into()) } else { absolute("XDG_RUNTIME_DIR") };
    Ok(base.ok_or(NoFolder { what: "the admin socket", variable: "XDG_RUNTIME_DIR" })?.join("gdp/ctl.sock"))
}

/// A relative path in these variables is invalid and to be ignored (XDG base directory specification).
fn absolute(variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute())
}
