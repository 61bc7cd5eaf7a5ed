//! A daemon on loopback UDP, without root, for tests that run it in their own process.

use std::path::Path;
use std::time::{Duration, Instant};

use gdp::link::RekeySchedule;
use gdp_ctl::config::{Config, DataPlane};

/// How long anything may take on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// A switch with its RIB; its files lie in the folder under this label.
pub fn config(folder: &Path, label: &str) -> Config {
    Config {
        identity: folder.join(format!("{label}.pem")),
        socket: folder.join(format!("{label}.sock")),
        interfaces: Some(Vec::new()),
        bpffs: None,
        udp: Some("127.0.0.1:0".parse().unwrap()),
        data_plane: DataPlane::Userspace,
        rib: true,
        neighbours: Vec::new(),
        ebpf_object: None,
        fib_capacity: 1024,
        domain: None,
        public: Vec::new(),
        etcd: None,
        rekey: RekeySchedule::default(),
    }
}

pub async fn wait(what: &str, condition: impl AsyncFn() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !condition().await {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}
