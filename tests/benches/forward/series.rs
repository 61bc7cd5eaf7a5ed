//! Who is compared in more than one figure.

pub const BARE: &str = "bare redirect";
pub const SWITCH: &str = "switch";
pub const FORKING: &str = "switch, copies leave there too";
pub const UNTAGGED: &str = "switch, tag off";
pub const IPV4: &str = "kernel IPv4";
pub const USERSPACE: &str = "AF_PACKET userspace";
