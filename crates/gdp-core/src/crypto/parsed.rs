//! Cache of recently parsed public keys, a few per thread. Decompressing a point takes half as long
//! as verifying a signature. The same owners and entities sign again and again, each time with the
//! key beside the signature.

use std::cell::RefCell;
use std::rc::Rc;

use super::{Backend, Verifier};
use crate::crypto::error::CryptoError;
use crate::crypto::lengths::PUBLIC_KEY_LEN;

const CACHED: usize = 64;

type Entry = ([u8; PUBLIC_KEY_LEN], Rc<Verifier>);

#[derive(Default)]
struct KeyCache {
    keys: Vec<Entry>,
    /// Index of the entry that is replaced next.
    oldest: usize,
}

thread_local! {
    static KEY_CACHE: RefCell<KeyCache> = RefCell::default();
}

/// Returns the parsed key for verification by the selected back end.
pub fn parsed(public: &[u8; PUBLIC_KEY_LEN]) -> Result<Rc<Verifier>, CryptoError> {
    KEY_CACHE.with_borrow_mut(|lately| {
        if let Some((_, known)) = lately.keys.iter().find(|(key, _)| key == public) {
            return Ok(known.clone());
        }
        let entry = (*public, Rc::new(Backend::selected().verifier(public)?));
        let verifier = entry.1.clone();
        if lately.keys.len() < CACHED {
            lately.keys.push(entry);
        } else {
            lately.keys[lately.oldest] = entry;
            lately.oldest = (lately.oldest + 1) % CACHED;
        }
        Ok(verifier)
    })
}

#[cfg(test)]
#[path = "../../tests/unit/crypto/parsed.rs"]
mod tests;
