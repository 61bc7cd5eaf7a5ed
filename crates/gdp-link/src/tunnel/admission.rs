//! Bounds the tunnels of a listener, in total and per address. No I/O.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};

/// Maximum number of tunnels.
pub const MAX_TUNNELS: usize = 1024;

/// Maximum number of tunnels from one [source](source_of). A NAT may hide many robots.
pub const MAX_TUNNELS_OF_ONE: usize = 128;

/// Maximum number of connections whose TLS handshake is not complete.
pub const MAX_OPENING: usize = 64;

/// Maximum number of these from one source.
pub const MAX_OPENING_OF_ONE: usize = 16;

/// Connections by source.
#[derive(Debug)]
pub struct Admission {
    max: usize,
    max_of_one: usize,
    total: usize,
    by_source: HashMap<IpAddr, usize>,
}

impl Admission {
    /// Admits `max` connections, and `max_of_one` from one source.
    pub fn new(max: usize, max_of_one: usize) -> Self {
        Self { max, max_of_one, total: 0, by_source: HashMap::new() }
    }

    /// Counts a connection. Returns `false` if there are too many.
    pub fn admit(&mut self, source: IpAddr) -> bool {
        let of_one = self.by_source.get(&source).copied().unwrap_or(0);
        if self.total >= self.max || of_one >= self.max_of_one {
            return false;
        }
        self.total += 1;
        self.by_source.insert(source, of_one + 1);
        true
    }

    /// Ends a connection that was admitted.
    pub fn release(&mut self, source: IpAddr) {
        self.total -= 1;
        if let Some(count) = self.by_source.get_mut(&source) {
            *count -= 1;
            if *count == 0 {
                self.by_source.remove(&source);
            }
        }
    }
}

/// Returns what limits count as one: an IPv4 address, or the /64 of an IPv6 address.
pub fn source_of(ip: IpAddr) -> IpAddr {
    match ip.to_canonical() {
        IpAddr::V6(ip) => Ipv6Addr::from_bits(ip.to_bits() & !u128::from(u64::MAX)).into(),
        ip => ip,
    }
}

#[cfg(test)]
#[path = "../../tests/unit/tunnel/admission.rs"]
mod tests;
