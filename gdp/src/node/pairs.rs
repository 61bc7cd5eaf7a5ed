//! The keys that this node shares with each of its counterparts, for what the two tell each other
//! alone. Made when they are first needed, kept as long as a name needs the counterpart.

use std::collections::HashMap;

use gdp_wire::Name;

use gdp_core::crypto::{CryptoError, PUBLIC_KEY_LEN};
use gdp_core::identity::Identity;
use gdp_e2e::feedback_wire::Feedback;
use gdp_e2e::keys::{PairError, PairKey, PairOpener, PairSealer};

pub struct Pairs {
    identity: Identity,
    peers: HashMap<Name, Peer>,
}

struct Peer {
    box_key: [u8; PUBLIC_KEY_LEN],
    /// Names in which it is a counterpart.
    uses: usize,
    keys: Option<(PairSealer, PairOpener)>,
}

impl Peer {
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
        Self { identity, peers: HashMap::new() }
    }

    /// An entity whose box key is verified is a counterpart in one more name.
    pub fn introduce(&mut self, entity: Name, box_key: [u8; PUBLIC_KEY_LEN]) {
        let peer = self.peers.entry(entity).or_insert(Peer { box_key, uses: 0, keys: None });
        peer.uses += 1;
        if peer.box_key != box_key {
            (peer.box_key, peer.keys) = (box_key, None);
        }
    }

    /// It is one in one name less.
    pub fn part(&mut self, entity: &Name) {
        if let Some(peer) = self.peers.get_mut(entity) {
            peer.uses -= 1;
            if peer.uses == 0 {
                self.peers.remove(entity);
            }
        }
    }

    /// Puts the payload of a frame to the entity's own name into `out`; `None` if it is no
    /// counterpart.
    pub fn seal(&mut self, entity: &Name, feedback: &Feedback, out: &mut Vec<u8>) -> Option<Result<(), PairError>> {
        let keys = self.peers.get_mut(entity)?.keys(&self.identity, entity);
        Some(keys.map_err(PairError::Crypto).and_then(|(sealer, _)| sealer.seal(feedback, out)))
    }

    /// What the entity says; `None` if it is no counterpart.
    pub fn open(&mut self, entity: &Name, payload: &[u8]) -> Option<Result<Feedback, PairError>> {
        let keys = self.peers.get_mut(entity)?.keys(&self.identity, entity);
        Some(keys.map_err(PairError::Crypto).and_then(|(_, opener)| opener.open(payload)))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/pairs.rs"]
mod tests;
