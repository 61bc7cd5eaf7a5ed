//! The relay: a userspace switch beside the proxy, for endpoints that reach no other switch. It
//! needs the feature `relay`.

#[cfg(feature = "relay")]
mod enabled;
#[cfg(not(feature = "relay"))]
mod stub;

#[cfg(feature = "relay")]
pub use enabled::{Relay, RunningRelay};
#[cfg(not(feature = "relay"))]
pub use stub::{Relay, RunningRelay};
