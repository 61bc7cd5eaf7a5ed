//! What a session and its handles share: the node, and the keyring.

use std::fmt;
use std::sync::{Arc, Weak};

use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Issued, Reading};
use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::task::AbortHandle;

use super::error::Error;
use super::followed_keyring::FollowedKeyring;
use super::publisher_handle::PublisherHandle;
use crate::keyring::{FindError, members};
use crate::node::Node;

/// An attached entity with its keyring.
pub struct Attached {
    pub node: Node,
    pub keyring: Mutex<FollowedKeyring>,
    /// Those that the session flushes when it is closed.
    pub publishers: Mutex<Vec<Weak<PublisherHandle>>>,
    /// Presents renewed credentials of the domain.
    pub following: Option<AbortHandle>,
}

impl Attached {
    pub fn name(&self) -> Name {
        self.node.name()
    }

    /// Finds a card in the keyring, or else in the directory of the domain.
    pub async fn find(&self, name: &str, kind: &str) -> Result<NameCard, Error> {
        let keyring = self.keyring.lock().current().clone();
        match keyring.find(name, kind) {
            Err(FindError::Unknown { .. }) if keyring.has_directory() => {
                let shared = members::find(&self.node, &keyring, name, kind).await?;
                Ok(self.keyring.lock().share(shared))
            }
            found => Ok(found?),
        }
    }

    /// Returns the right to read or call a name that was found.
    pub fn grant(&self, card: &NameCard) -> Result<Reading, Error> {
        Ok(self.keyring.lock().grant(card, self.name())?)
    }

    /// Returns the right to publish or serve a name that was found.
    pub fn ad(&self, card: &NameCard) -> Result<Issued<AdCert>, Error> {
        Ok(self.keyring.lock().ad(card, self.name())?)
    }

    /// Finds the right to read or call a name again, also with another member.
    pub async fn new_grant(&self, card: &NameCard, name: &str, kind: &str) -> Result<Reading, Error> {
        self.find(name, kind).await?;
        self.grant(card)
    }

    pub fn remember(&self, publisher: &Arc<PublisherHandle>) {
        let mut publishers = self.publishers.lock();
        publishers.retain(|publisher| publisher.strong_count() > 0);
        publishers.push(Arc::downgrade(publisher));
    }
}

impl Drop for Attached {
    fn drop(&mut self) {
        // The task has a clone of the node.
        if let Some(following) = &self.following {
            following.abort();
        }
    }
}

impl fmt::Debug for Attached {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Session").field("name", &self.name()).field("switch", &self.node.switch().ok()).finish()
    }
}
