//! Whether native XDP on an interface disturbs what else uses the interface. Then it is for people
//! to say that it is wanted.

use super::device::driver;
use super::xdp_features::Features;

/// Drivers that take a program without a change of the link, its queues, MTU or offloads. Those of
/// network cards set their queues up anew, and most take the link down meanwhile; virtio_net gives
/// up offloads.
const UNDISTURBED: [&str; 2] = ["veth", "tun"];

/// What attaching would disturb; `None`: nothing. `features`: `None` before Linux 6.3.
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
