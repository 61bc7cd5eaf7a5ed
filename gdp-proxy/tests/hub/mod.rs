//! The switch with its RIB that the tests' proxies attach to: on loopback UDP, without root.

use std::path::Path;

use gdp::link::RekeySchedule;
use gdp_ctl::config::{Config, DataPlane, DomainConfig};

/// Its files lie in the folder, as `hub.…`.
pub fn config(folder: &Path, domain: Option<DomainConfig>) -> Config {
    Config {
        identity: folder.join("hub.pem"),
        socket: folder.join("hub.sock"),
        interfaces: Some(Vec::new()),
        udp: Some("127.0.0.1:0".parse().unwrap()),
        data_plane: DataPlane::Userspace,
        rib: true,
        neighbours: Vec::new(),
        ebpf_object: None,
        fib_capacity: 1024,
        bpffs: None,
        domain,
        public: Vec::new(),
        etcd: None,
        rekey: RekeySchedule::default(),
    }
}
