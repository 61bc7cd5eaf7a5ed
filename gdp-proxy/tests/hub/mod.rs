//! The switch with its RIB that the tests' proxies attach to: on loopback UDP, without root.

use std::path::Path;

use gdp_daemon::config::{Config, DomainConfig};

/// Its files lie in the folder, as `hub.…`.
pub fn config(folder: &Path, domain: Option<DomainConfig>) -> Config {
    Config {
        rib: true,
        fib_capacity: 1024,
        domain,
        ..Config::userspace(folder.join("hub.pem"), "127.0.0.1:0".parse().unwrap())
    }
}
