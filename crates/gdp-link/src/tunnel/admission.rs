//! Bounds the tunnels of a listener, in total and per address. No I/O.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};

/// Maximum number of tunnels.
pub const MAX_TUNNELS: usize = 1024;

/// Maximum number of tunnels from one [source](source_of). A NAT may hide many robots.
const MAX_TUNNELS_OF_ONE: usize = 128;

/// The tunnels by source.
#[derive(Debug, Default)]
pub struct Admission {
    total: usize,
    by_source: HashMap<IpAddr, usize>,
}

impl Admission {
    /// Counts a tunnel. Returns `false` if there are too many.
    pub fn admit(&mut self, source: IpAddr) -> bool {
        let of_one = self.by_source.get(&source).copied().unwrap_or(0);
        if self.total >= MAX_TUNNELS || of_one >= MAX_TUNNELS_OF_ONE {
            return false;
        }
        self.total += 1;
        self.by_source.insert(source, of_one + 1);
        true
    }

    /// Ends a tunnel that was admitted.
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
