//! Operation that an entity's statement requests of a RIB.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Operation of an entity on a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AdvertOp {
    /// The entity sends messages to the name.
    Publish,
    /// The entity reads the name's messages.
    Subscribe,
    /// The entity answers requests to the name.
    Serve,
    /// The entity sends requests to the name.
    Call,
    /// The entity withdraws its statements about the name.
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
