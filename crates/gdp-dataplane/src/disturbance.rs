//! Detects whether native XDP on an interface would disturb its other users. The operator must then
//! request XDP explicitly.

use super::device::driver;
use super::xdp_features::Features;

/// Drivers that accept a program without changing the link, its queues, MTU or offloads. Drivers of
/// network cards set up their queues again, and most take the link down meanwhile. virtio_net
/// disables offloads.
const UNDISTURBED: [&str; 2] = ["veth", "tun"];

/// Returns what attaching would disturb, or `None` for no disturbance. `features` is `None` before
/// Linux 6.3.
pub fn of(interface: &str, features: Option<Features>) -> Option<String> {
    disturbs(driver(interface).as_deref(), features)
}

fn disturbs(driver: Option<&str>, features: Option<Features>) -> Option<String> {
    let refuses = features.is_some_and(|features| !features.native());
    let driver = driver.unwrap_or("without a name");
    let disturbed = !refuses && !UNDISTURBED.contains(&driver);
    disturbed.then(|| format!("with XDP the driver {driver} may reset the link or change its offloads"))
}

#[cfg(test)]
#[path = "../tests/unit/disturbance.rs"]
mod tests;
