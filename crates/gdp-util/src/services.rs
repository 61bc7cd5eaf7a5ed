//! The units of the packages, which `gdp-ctl up` and `gdp-proxy join` start through systemctl(1).

use std::path::Path;
use std::process::Stdio;
use std::{env, fmt, io};

use crate::os;

/// Where packages install units.
const UNITS: &str = "/usr/lib/systemd/system";

/// Exists while systemd is the service manager, see sd_booted(3).
const BOOTED: &str = "/run/systemd/system";

/// The units of this machine. They exist only where the packages are installed and systemd runs.
pub struct Services(());

#[derive(Debug)]
pub struct SystemctlError {
    command: String,
    reason: String,
}

impl fmt::Display for SystemctlError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { command, reason } = self;
        write!(f, "`{command}` failed: {reason}; `journalctl --unit 'gdp-*'` has the log of the services")
    }
}

impl std::error::Error for SystemctlError {}

impl Services {
    /// Returns the units, if root runs the installed program for the folder that they use.
    /// `--foreground` and a folder of one's own are for programs without units.
    pub fn find(unit: &str, folder: &Path, of_units: &str) -> Option<Self> {
        let is_installed = env::current_exe().is_ok_and(|own| own.parent() == Some(Path::new("/usr/bin")));
        let has_unit = Path::new(UNITS).join(unit).is_file() && Path::new(BOOTED).is_dir();
        (os::is_root() && is_installed && has_unit && folder == Path::new(of_units)).then_some(Self(()))
    }

    /// Starts units, now and at each boot. Units that run are started again with their new files.
    pub fn start(&self, units: &[&str]) -> Result<(), SystemctlError> {
        systemctl("enable", units)?;
        systemctl("restart", units)
    }

    /// Stops units, now and at each boot.
    pub fn stop(&self, units: &[&str]) -> Result<(), SystemctlError> {
        systemctl("stop", units)?;
        systemctl("disable", units)
    }
}

#[expect(clippy::disallowed_methods, reason = "systemctl exists wherever systemd runs, so nobody installs it")]
fn systemctl(verb: &str, units: &[&str]) -> Result<(), SystemctlError> {
    let mut command = std::process::Command::new("systemctl");
    command.arg("--quiet").arg(verb).args(units).stdin(Stdio::null());
    let failed = |reason: String| {
        let command = format!("systemctl {verb} {}", units.join(" "));
        Err(SystemctlError { command, reason })
    };
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => failed(status.to_string()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => failed("there is no systemctl".into()),
        Err(error) => failed(error.to_string()),
    }
}
