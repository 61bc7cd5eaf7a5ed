//! The DPDK part of a switch's configuration.

use serde_json::{Value, json};

/// DPDK drivers for kernel interfaces.
pub const DRIVERS: [&str; 2] = ["net_af_packet", "net_af_xdp"];

/// Options with which `net_af_packet` accepts packets of an MTU of up to 4016 bytes.
const LARGE_FRAMES: &str = ",framesz=4096,blocksz=4096";

/// Returns the configuration of a data plane, or of a DPDK driver, on these interfaces with this
/// MTU. The parts are the interfaces to run on, `data_plane` and `dpdk`. With DPDK, the interfaces
/// are the host's sides of the ports; their names begin with a `g`.
pub fn planned(data_plane: &'static str, interfaces: &[&str], mtu: u32) -> (Vec<String>, &'static str, Value) {
    if !DRIVERS.contains(&data_plane) {
        return (interfaces.iter().map(|interface| (*interface).to_owned()).collect(), data_plane, json!({}));
    }
    let hosts: Vec<String> = interfaces.iter().map(|interface| format!("g{interface}")).collect();
    let more = if data_plane == "net_af_packet" && mtu > 1500 { LARGE_FRAMES } else { "" };
    let port = |(i, (host, interface)): (usize, (&String, &&str))| json!({"interface": host, "device": format!("{data_plane}{i},iface={interface}{more}"), "mtu": mtu});
    let ports: Vec<Value> = hosts.iter().zip(interfaces).enumerate().map(port).collect();
    (hosts, "dpdk", json!({"ports": ports, "memory_mib": 128}))
}
