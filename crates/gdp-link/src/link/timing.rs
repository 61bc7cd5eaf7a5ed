//! The timing and the limits of a link's control connection.

use std::time::Duration;

/// A silent link sends a packet this often.
pub const KEEP_ALIVE: Duration = Duration::from_secs(1);

/// A link is lost when nothing arrives for this long.
pub const IDLE_TIMEOUT: Duration = Duration::from_secs(4);

/// From the first packet to both hellos.
pub const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// From a request to its response.
pub const REQUEST_TIMEOUT: Duration = Duration::from_secs(5);

/// Requests a peer can have open at once.
pub const MAX_STREAMS: u32 = 32;
