//! What an application sees of a node's links.

use gdp_wire::Name;
use serde::Serialize;

/// The state and counters of a link.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LinkStatus {
    pub target: String,
    pub state: LinkState,
    /// Why the link is not up.
    pub reason: Option<String>,
    /// Whether this is the main link.
    pub main: bool,
    /// The current or last switch at the other end; `None` if the link is down.
    pub switch: Option<Name>,
    pub frames_sent: u64,
    pub frames_unsent: u64,
    /// Copies among the frames sent, which the main link carried as well. Dropped copies did not
    /// fit the budget or the MTU, or were still queued when the link was lost.
    pub copies_sent: u64,
    pub copies_dropped: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LinkState {
    Up,
    /// The link is up, but the switch has not answered the latest echoes.
    Silent,
    /// The switch became silent; its data plane may continue to forward.
    Stale,
    Down,
}
