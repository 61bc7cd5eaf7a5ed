//! What the statement of an entity asks of a RIB.

use std::fmt;

use serde::{Deserialize, Serialize};

/// What an entity states about a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AdvertOp {
    /// I send messages to the name.
    Publish,
    /// I read the name's messages.
    Subscribe,
    /// I answer requests to the name.
    Serve,
    /// I send requests to the name.
    Call,
    /// Whatever I stated about the name ends.
    Withdraw,
}

impl fmt::Display for AdvertOp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Publish => "publish",
            Self::Subscribe => "subscribe",
            Self::Serve => "serve",
            Self::Call => "call",
            Self::Withdraw => "withdraw",
        })
    }
}
