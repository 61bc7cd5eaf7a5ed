//! Contenders that appear in more than one figure.

pub const BARE: &str = "bare redirect";
pub const SWITCH: &str = "switch";
pub const FORKING: &str = "switch, copies leave there too";
pub const UNTAGGED: &str = "switch, tag off";
pub const IPV4: &str = "kernel IPv4";
pub const DPDK_PACKET: &str = "DPDK, af_packet";
pub const DPDK_XDP: &str = "DPDK, af_xdp";
pub const TESTPMD_PACKET: &str = "testpmd, af_packet";
pub const TESTPMD_XDP: &str = "testpmd, af_xdp";
pub const USERSPACE: &str = "AF_PACKET userspace";
