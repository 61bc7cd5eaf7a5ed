//! The handle of the node that all clones of a publisher share.

use std::time::Duration;

use gdp_core::card::NameCard;

use super::error::Error;
use crate::node;
use crate::node::NodeError;

/// A publisher of the node, with what the program knows of its name.
pub struct PublisherHandle {
    pub node: node::Publisher,
    pub card: NameCard,
    /// The topic as the program named it.
    pub topic: String,
}

impl PublisherHandle {
    pub async fn flush(&self, timeout: Duration) -> Result<(), Error> {
        self.node.flush_shared(timeout).await.map_err(|error| match error {
            NodeError::Unflushed(source) => Error::Unflushed { name: self.topic.clone(), source },
            other => other.into(),
        })
    }
}
