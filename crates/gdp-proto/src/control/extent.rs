//! How much of a set is in one message.

use serde::{Deserialize, Serialize};

/// How a push relates to what the switch holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Extent {
    /// Changes generation − 1. A switch that holds another one refuses, and is sent the whole.
    Delta,
    /// Part of the whole: with part 0 the switch marks all it holds, with the last it sweeps what
    /// was not set since. What an earlier RIB, or an earlier daemon of the switch, had said is
    /// swept only if this RIB is not [settling](FibPush).
    Full { part: u32, last: bool },
}
