//! Keeps the kernel from taking up what arrives at an interface that DPDK has as a device. With some drivers the kernel gets all of it
//! as well, and would answer twice, on the host's side of the port and here.

use std::fs;
use std::path::PathBuf;

/// What is set while DPDK has the interface: a packet whose sender is not reached by it is not for this host, no address is answered for,
/// and IPv6 is off.
const SETTINGS: [(&str, &str, &str); 3] =
    [("ipv4", "rp_filter", "1"), ("ipv4", "arp_ignore", "8"), ("ipv6", "disable_ipv6", "1")];

/// That the kernel is quiet on an interface. When dropped, all is as it was.
pub struct Quiet {
    before: Vec<(PathBuf, String)>,
}

impl Quiet {
    /// In the network namespace of the calling thread, in which it is to be dropped as well.
    pub fn keep(interface: &str) -> Self {
        let mut before = Vec::new();
        for (family, name, value) in SETTINGS {
            let path = PathBuf::from(format!("/proc/sys/net/{family}/conf/{interface}/{name}"));
            // Without IPv6 there is nothing to turn off.
            let Ok(now) = fs::read_to_string(&path) else { continue };
            match fs::write(&path, value) {
                Ok(()) => before.push((path, now)),
                Err(error) => tracing::warn!(path = %path.display(), %error, "the kernel may answer beside DPDK"),
            }
        }
        Self { before }
    }
}

impl Drop for Quiet {
    fn drop(&mut self) {
        for (path, value) in self.before.drain(..) {
            if let Err(error) = fs::write(&path, value) {
                // As when the interface was deleted.
                tracing::debug!(path = %path.display(), %error, "a setting stays");
            }
        }
    }
}
