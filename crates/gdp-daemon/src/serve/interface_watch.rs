//! Watches what keeps interfaces from carrying links: no carrier, or an MTU that is too small. The
//! topology avoids links without a carrier. The log and `gdp-ctl status` name small MTUs, because
//! all handshakes fail on them, and an existing link falls silent.

use std::collections::BTreeMap;
use std::sync::Arc;

use gdp_dataplane::host_pair;
use gdp_link::port::{MIN_ETHERNET_MTU, min_udp_mtu};
use tokio::sync::watch;

use super::core::Core;
use super::daemon::Daemon;
use super::interfaces::{self, InterfaceState, SmallMtu};

/// Watches the interfaces until the daemon ends. `named` are those with links on Ethernet.
pub async fn run(daemon: Arc<Daemon>, named: Vec<String>, mut changes: watch::Receiver<()>) {
    loop {
        match interfaces::states().await {
            Ok(states) => take(&daemon, &named, &states),
            Err(error) => tracing::warn!(%error, "cannot ask the kernel for the state of its interfaces"),
        }
        interfaces::look(&mut changes).await;
    }
}

fn take(daemon: &Daemon, named: &[String], states: &[InterfaceState]) {
    let dark = states.iter().filter(|state| !state.has_carrier).map(|state| state.index).collect();
    let changed = {
        let core = &mut *daemon.core();
        let small = small_mtus(core, daemon.udp.get().map(|udp| min_udp_mtu(udp.ip())), named, states);
        log_changes(&core.switch.small_mtus, &small);
        core.switch.small_mtus = small;
        core.switch.set_no_carrier(dark)
    };
    if changed {
        daemon.topology_changed();
    }
}

/// Returns the interfaces in use whose MTU is too small. `over_udp` is what links over UDP need,
/// if there are any.
fn small_mtus(
    core: &Core,
    over_udp: Option<u32>,
    named: &[String],
    states: &[InterfaceState],
) -> BTreeMap<String, SmallMtu> {
    let planes = core.switch.planes.report();
    let needed = |name: &String| {
        // A small MTU also ends the plane of a named interface.
        let is_named = named.contains(name);
        let is_used = is_named || planes.iter().any(|plane| plane.interface == *name) && !host_pair::is_end(name);
        is_named.then_some(MIN_ETHERNET_MTU).max(over_udp.filter(|_| is_used))
    };
    let small = |state: &InterfaceState| {
        let needed = needed(&state.name).filter(|needed| state.mtu < *needed)?;
        Some((state.name.clone(), SmallMtu { mtu: state.mtu, needed }))
    };
    states.iter().filter_map(small).collect()
}

fn log_changes(before: &BTreeMap<String, SmallMtu>, now: &BTreeMap<String, SmallMtu>) {
    for (interface, SmallMtu { mtu, needed }) in now.iter().filter(|(name, small)| before.get(*name) != Some(small)) {
        tracing::warn!(
            interface,
            mtu,
            needed,
            "the MTU of {interface} is too small for links: `ip link set dev {interface} mtu {needed}` or more"
        );
    }
    for interface in before.keys().filter(|name| !now.contains_key(*name)) {
        tracing::info!(interface, "the MTU of the interface is no longer too small");
    }
}
