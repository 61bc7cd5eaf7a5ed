//! The pair keys that this node shares with each counterpart, for feedback between the two. Each
//! key is created on first use and retained as long as a name has the counterpart.

use std::collections::HashMap;

use gdp_wire::Name;
use parking_lot::Mutex;

use gdp_core::crypto::{CryptoError, PUBLIC_KEY_LEN};
use gdp_core::identity::Identity;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::keys::{PairError, PairKey, PairOpener, PairSealer};

/// Its lock is a leaf: no other lock is taken while it is locked.
pub struct Pairs {
    identity: Identity,
    counterparts: Mutex<HashMap<Name, Pair>>,
}

struct Pair {
    box_key: [u8; PUBLIC_KEY_LEN],
    /// Number of names that have this counterpart.
    uses: usize,
    keys: Option<(PairSealer, PairOpener)>,
}

impl Pair {
    fn keys(&mut self, own: &Identity, name: &Name) -> Result<&mut (PairSealer, PairOpener), CryptoError> {
        if self.keys.is_none() {
            let key = PairKey::new((own.name(), own.box_key()), (*name, &self.box_key))?;
            self.keys = Some((key.sealer()?, key.opener()));
        }
        self.keys.as_mut().ok_or(CryptoError::BadPublicKey)
    }
}

impl Pairs {
    pub fn new(identity: Identity) -> Self {
        Self { identity, counterparts: Mutex::default() }
    }

    /// Adds an entity, whose box key is verified, as a counterpart in one more name.
    pub fn introduce(&self, entity: Name, box_key: [u8; PUBLIC_KEY_LEN]) {
        let counterparts = &mut *self.counterparts.lock();
        let pair = counterparts.entry(entity).or_insert(Pair { box_key, uses: 0, keys: None });
        pair.uses += 1;
        if pair.box_key != box_key {
            (pair.box_key, pair.keys) = (box_key, None);
        }
    }

    /// Removes an entity as a counterpart in one name.
    pub fn part(&self, entity: &Name) {
        let counterparts = &mut *self.counterparts.lock();
        if let Some(pair) = counterparts.get_mut(entity) {
            pair.uses -= 1;
            if pair.uses == 0 {
                counterparts.remove(entity);
            }
        }
    }

    /// Writes the payload of a frame to the entity's own name into `out`. Returns `None` if the
    /// entity is no counterpart.
    pub fn seal(&self, entity: &Name, feedback: &[Feedback], out: &mut Vec<u8>) -> Option<Result<(), PairError>> {
        let counterparts = &mut *self.counterparts.lock();
        let keys = counterparts.get_mut(entity)?.keys(&self.identity, entity);
        Some(keys.map_err(PairError::Crypto).and_then(|(sealer, _)| sealer.seal(feedback, out)))
    }

    /// Opens feedback from the entity. Returns `None` if the entity is no counterpart.
    pub fn open(&self, entity: &Name, payload: &[u8]) -> Option<Result<Vec<Feedback>, PairError>> {
        let counterparts = &mut *self.counterparts.lock();
        let keys = counterparts.get_mut(entity)?.keys(&self.identity, entity);
        Some(keys.map_err(PairError::Crypto).and_then(|(_, opener)| opener.open(payload)))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/pairs.rs"]
mod tests;
