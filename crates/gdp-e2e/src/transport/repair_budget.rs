//! The bytes that may be sent again to one reader: a share of what the topic has sent of late. A
//! reader on a bad path, or a hostile one, then costs the others no more.

use super::MS;

/// Share of the first transmissions, and that of a reader that lags.
const SHARE: u64 = 4;
const LAGGING_SHARE: u64 = 16;
/// Maximum credit in bytes.
const MOST: i64 = 16 << 20;

/// Rate in bytes per second at which repairs are possible while nothing is sent, and the maximum
/// credit from it, in bytes.
const LEAST_RATE: u64 = 256 << 10;
const LEAST: i64 = 128 << 10;

/// Cost in bytes of each requested frame, in addition to its repair.
const LOOK: u64 = 16;

/// Bytes of a topic's first transmissions: in all, and in the last seconds.
#[derive(Clone, Copy, Debug)]
pub struct Fresh {
    pub total: u64,
    pub recent: u64,
}

#[derive(Clone, Copy, Debug)]
pub struct RepairBudget {
    /// Bytes, negative after a repair larger than the credit.
    credit: i64,
    /// Bytes of first transmissions that have been credited.
    sent: u64,
    at: u64,
}

impl RepairBudget {
    /// Returns the budget of a reader that joins at `now`, after `sent` bytes of first
    /// transmissions.
    pub fn new(now: u64, sent: u64) -> Self {
        Self { credit: LEAST, sent, at: now }
    }

    /// Pays for a repair of `bytes` bytes, if there is credit.
    pub fn pay(&mut self, now: u64, bytes: u64, fresh: Fresh, is_lagging: bool) -> bool {
        let share = if is_lagging { LAGGING_SHARE } else { SHARE };
        let elapsed = now.saturating_sub(self.at).min(1_000 * MS);
        let earned = (elapsed * LEAST_RATE / (1_000 * MS)) as i64;
        if earned > 0 {
            self.credit = self.credit.max((self.credit + earned).min(LEAST));
            self.at = now;
        }
        // Credit that a reader did not need expires.
        let most = (LEAST + (fresh.recent / share) as i64).min(MOST);
        self.credit = (self.credit + (fresh.total.saturating_sub(self.sent) / share) as i64).min(most);
        self.sent = fresh.total;
        let is_allowed = self.credit > 0;
        let cost = if is_allowed { bytes + LOOK } else { LOOK };
        self.credit = (self.credit - cost as i64).max(-MOST);
        is_allowed
    }
}

#[cfg(test)]
#[path = "../../tests/unit/transport/repair_budget.rs"]
mod tests;
