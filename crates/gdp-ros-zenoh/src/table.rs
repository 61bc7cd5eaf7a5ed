//! The tokens that exist, and the graph that consists of them.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::token::{self, Gid, Token};

/// Bound on the tokens of a graph. Further ones are ignored.
pub const MAX_TOKENS: usize = 16_384;

/// A node or an endpoint that exists.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entity {
    pub gid: Gid,
    pub token: Token,
}

/// All entities of other sessions.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Snapshot {
    pub entities: Vec<Arc<Entity>>,
}

/// The reason why a token is not in the graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TokenError {
    #[error("a liveliness token is not in the form of rmw_zenoh")]
    Malformed,
    #[error("the graph has {MAX_TOKENS} nodes and endpoints, and no further one is admitted")]
    Full,
}

/// The tokens by their texts.
#[derive(Default)]
pub struct Table(BTreeMap<String, Arc<Entity>>);

impl Table {
    pub fn insert(&mut self, text: &str) -> Result<(), TokenError> {
        let token = Token::parse(text).ok_or(TokenError::Malformed)?;
        if self.0.len() >= MAX_TOKENS && !self.0.contains_key(text) {
            return Err(TokenError::Full);
        }
        self.0.insert(text.to_owned(), Arc::new(Entity { gid: token::gid(text), token }));
        Ok(())
    }

    pub fn remove(&mut self, text: &str) {
        self.0.remove(text);
    }

    pub fn snapshot(&self) -> Snapshot {
        Snapshot { entities: self.0.values().cloned().collect() }
    }
}

#[cfg(test)]
#[path = "../tests/unit/table.rs"]
mod tests;
