//! Extent of a push: changes or part of the full set.

use serde::{Deserialize, Serialize};

/// Relation of a push to the state that the receiver holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Extent {
    /// Changes relative to generation − 1. A receiver with another generation refuses the push, and
    /// a full transfer follows.
    Delta,
    /// Part of a full transfer. At part 0 the receiver marks all its entries. After the last part
    /// it sweeps the entries not set since. A switch keeps entries of an earlier RIB or daemon as
    /// long as this RIB is [settling](FibPush).
    Full { part: u32, last: bool },
}
