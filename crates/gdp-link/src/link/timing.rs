//! The timing and the limits of a link's control connection.

use std::time::Duration;

/// Interval of keep-alive packets on an idle link. The side that dialled sends them.
pub const KEEP_ALIVE: Duration = Duration::from_secs(1);

/// A link counts as lost after this time without a packet.
pub const IDLE_TIMEOUT: Duration = Duration::from_secs(4);

/// Maximum time from the first packet to both hellos.
pub const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum time from a request to its response.
pub const REQUEST_TIMEOUT: Duration = Duration::from_secs(5);

/// Number of requests that a peer can have open at once.
pub const MAX_STREAMS: u32 = 32;
