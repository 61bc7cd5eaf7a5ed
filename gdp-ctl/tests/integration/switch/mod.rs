//! A daemon on loopback UDP, without root, for tests that run it in their own process.

use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

use gdp_core::identity::Identity;
use gdp_daemon::config::{Config, Neighbour, NeighbourAddress, Via};
use gdp_wire::Name;

use crate::ports::free_addr;

/// Timeout for any operation on a busy machine.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// Returns the configuration of a switch with its RIB. Its files are in the folder under this
/// label.
pub fn config(folder: &Path, label: &str) -> Config {
    let identity = folder.join(format!("{label}.pem"));
    Config { rib: true, fib_capacity: 1024, ..Config::userspace(identity, "127.0.0.1:0".parse().unwrap()) }
}

pub async fn wait(what: &str, condition: impl AsyncFn() -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !condition().await {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// s1 – s2 – s3, over UDP; s3 is the RIB.
pub struct Chain<'a> {
    pub folder: &'a Path,
    pub names: Vec<Name>,
    pub addrs: Vec<SocketAddr>,
}

impl<'a> Chain<'a> {
    pub fn new(folder: &'a Path) -> Self {
        let name = |i| Identity::load_or_generate(&folder.join(format!("s{i}.pem")), "switch").unwrap().name();
        Self { folder, names: (1..=3).map(name).collect(), addrs: (0..3).map(|_| free_addr()).collect() }
    }

    pub fn config(&self, i: usize) -> Config {
        let place = |j: usize| NeighbourAddress { switch: self.names[j], via: Via::Udp(self.addrs[j]) };
        let near = [i.checked_sub(1), (i < 2).then_some(i + 1)].into_iter().flatten();
        Config {
            udp: Some(self.addrs[i]),
            rib: i == 2,
            neighbours: near
                .map(|j| Neighbour { address: place(j), cost: Some(1), dial: false, parent: false, tls: None })
                .collect(),
            ..config(self.folder, &format!("s{}", i + 1))
        }
    }
}
