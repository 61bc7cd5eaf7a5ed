//! The keys that this node shares with each of its counterparts, for what the two tell each other
//! alone. Made when they are first needed, kept as long as a name needs the counterpart.

use std::collections::HashMap;

use gdp_wire::Name;
use parking_lot::Mutex;

use gdp_core::crypto::{CryptoError, PUBLIC_KEY_LEN};
use gdp_core::identity::Identity;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::keys::{PairError, PairKey, PairOpener, PairSealer};

/// Its lock is never held while anything else is locked.
pub struct Pairs {
    identity: Identity,
    counterparts: Mutex<HashMap<Name, Pair>>,
}

struct Pair {
    box_key: [u8; PUBLIC_KEY_LEN],
    /// Names in which it is a counterpart.
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

    /// An entity whose box key is verified is a counterpart in one more name.
    pub fn introduce(&self, entity: Name, box_key: [u8; PUBLIC_KEY_LEN]) {
        let counterparts = &mut *self.counterparts.lock();
        let pair = counterparts.entry(entity).or_insert(Pair { box_key, uses: 0, keys: None });
        pair.uses += 1;
        if pair.box_key != box_key {
            (pair.box_key, pair.keys) = (box_key, None);
        }
    }

    /// It is one in one name less.
    pub fn part(&self, entity: &Name) {
        let counterparts = &mut *self.counterparts.lock();
        if let Some(pair) = counterparts.get_mut(entity) {
            pair.uses -= 1;
            if pair.uses == 0 {
                counterparts.remove(entity);
            }
        }
    }

    /// Puts the payload of a frame to the entity's own name into `out`; `None` if it is no
    /// counterpart.
    pub fn seal(&self, entity: &Name, feedback: &Feedback, out: &mut Vec<u8>) -> Option<Result<(), PairError>> {
        let counterparts = &mut *self.counterparts.lock();
        let keys = counterparts.get_mut(entity)?.keys(&self.identity, entity);
        Some(keys.map_err(PairError::Crypto).and_then(|(sealer, _)| sealer.seal(feedback, out)))
    }

    /// What the entity says; `None` if it is no counterpart.
    pub fn open(&self, entity: &Name, payload: &[u8]) -> Option<Result<Feedback, PairError>> {
        let counterparts = &mut *self.counterparts.lock();
        let keys = counterparts.get_mut(entity)?.keys(&self.identity, entity);
        Some(keys.map_err(PairError::Crypto).and_then(|(_, opener)| opener.open(payload)))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/pairs.rs"]
mod tests;
