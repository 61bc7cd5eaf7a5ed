//! Notifications to the service manager that started this process, after sd_notify(3): ready,
//! reloading, stopping, a status line, and that the work goes on. Without a service manager they
//! do nothing.

use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::Path;
use std::time::{Duration, Instant};

/// The longest status line, in bytes.
const MAX_STATUS: usize = 512;

/// The service manager's socket, and how often it expects to know that the work goes on.
#[derive(Debug, Default)]
pub struct ServiceManager {
    socket: Option<UnixDatagram>,
    /// Half of the time after which the service manager ends a process that does not answer.
    interval: Option<Duration>,
    /// When the service manager was last told that the work goes on.
    alive: Option<Instant>,
}

impl ServiceManager {
    /// Connects to the socket that the environment names. Warns if that fails, because the service
    /// manager then ends this process after a while.
    pub fn from_environment() -> Self {
        let variable = |name: &str| std::env::var_os(name);
        let parse = |name: &str| variable(name)?.to_str()?.parse::<u64>().ok();
        // The watchdog may be meant for the process that started this one.
        let is_meant = parse("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        let watchdog = parse("WATCHDOG_USEC").filter(|_| is_meant).map(Duration::from_micros);
        match variable("NOTIFY_SOCKET").map(|socket| Self::connect(&socket, watchdog)) {
            None => Self::default(),
            Some(Ok(manager)) => manager,
            Some(Err(error)) => {
                tracing::warn!(%error, "cannot reach the service manager at NOTIFY_SOCKET");
                Self::default()
            }
        }
    }

    /// Connects to a socket: a path, or the name of an abstract socket after an `@`.
    pub fn connect(socket: &OsStr, watchdog: Option<Duration>) -> io::Result<Self> {
        let address = match socket.as_bytes() {
            [b'@', name @ ..] => SocketAddr::from_abstract_name(name)?,
            [b'/', ..] => SocketAddr::from_pathname(Path::new(socket))?,
            _ => return Err(io::Error::new(io::ErrorKind::InvalidInput, "neither a path nor an abstract socket")),
        };
        let datagrams = UnixDatagram::unbound()?;
        datagrams.connect_addr(&address)?;
        // A service manager that does not read must not stop the work.
        datagrams.set_nonblocking(true)?;
        let interval = watchdog.filter(|time| !time.is_zero()).map(|time| time / 2);
        Ok(Self { socket: Some(datagrams), interval, alive: None })
    }

    /// The process does its work from now on.
    pub fn ready(&mut self, status: &str) {
        self.send(&format!("READY=1\n{}", status_line(status)));
        // A service manager counts from here, so the next round of work is told at once.
        self.alive = None;
    }

    /// A line for `systemctl status`.
    pub fn status(&self, status: &str) {
        self.send(&status_line(status));
    }

    /// The process reads its configuration again. [`Self::ready`] follows.
    pub fn reloading(&self) {
        // SAFETY: zero is a valid value of this structure of integers.
        let mut now: libc::timespec = unsafe { std::mem::zeroed() };
        // SAFETY: a structure that outlives the call.
        unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut now) };
        let now = Duration::new(now.tv_sec.unsigned_abs(), now.tv_nsec as u32);
        self.send(&format!("RELOADING=1\nMONOTONIC_USEC={}", now.as_micros()));
    }

    /// The process ends.
    pub fn stopping(&self) {
        self.send("STOPPING=1");
    }

    /// The work goes on. Call this from the loop that does it, more often than the watchdog's
    /// interval; the service manager learns of it once an interval.
    pub fn alive(&mut self, now: Instant) {
        let Some(interval) = self.interval else { return };
        if self.alive.is_none_or(|last| now.saturating_duration_since(last) >= interval) {
            self.alive = Some(now);
            self.send("WATCHDOG=1");
        }
    }

    fn send(&self, text: &str) {
        let Some(socket) = &self.socket else { return };
        if let Err(error) = socket.send(text.as_bytes()) {
            tracing::debug!(%error, "the service manager did not take a notification");
        }
    }
}

/// Returns the assignment of a status. A line break would begin another assignment.
fn status_line(status: &str) -> String {
    let status: String = status.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    format!("STATUS={}", &status[..status.floor_char_boundary(MAX_STATUS)])
}

#[cfg(test)]
#[path = "../tests/unit/service_manager.rs"]
mod tests;
