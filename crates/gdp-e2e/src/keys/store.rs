//! A reader's keys for one name, from the boxes of its writers. The store retains the newest and
//! the previous epoch of each writer, so that messages from before a change still open. It wipes
//! the previous epoch [`GRACE`] after the newer one arrived.

use std::collections::HashMap;
use std::fmt;
use std::time::Duration;

use gdp_core::cert::{CertError, Signed};
use gdp_core::crypto;
use gdp_core::identity::{Identity, VerifyKey};
use gdp_core::keys::{self, BoxKey, EpochKey, KeyBox};
use gdp_core::name::Name;

/// Maximum number of writers of a name with keys in the store.
pub const MAX_WRITERS: usize = 1024;

/// Retention time of the previous epoch. It is longer than a writer takes to use the newest epoch,
/// and longer than a writer repeats messages.
const GRACE: Duration = Duration::from_secs(60);

/// A key that is new to the reader.
#[derive(Clone, Debug)]
pub struct Opened {
    pub epoch: u32,
    /// The key of the epoch. It replaces a known key of the same epoch, which means that the writer
    /// restarted within a second.
    pub key: EpochKey,
    /// The older epoch that was dropped for it.
    pub dropped: Option<u32>,
}

/// The reason that a box was not accepted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    #[error(transparent)]
    Box(#[from] CertError),
    #[error("a box of epoch {epoch}, which is over: the writer is at {newest}")]
    Over { epoch: u32, newest: u32 },
    #[error("keys of {MAX_WRITERS} writers of this name are kept already")]
    TooManyWriters,
}

/// The keys of all writers of one name that wrap them for one reader.
pub struct KeyStore {
    name: Name,
    reader: Name,
    box_key: BoxKey,
    writers: HashMap<Name, CachedKey>,
}

struct CachedKey {
    newest: (u32, EpochKey),
    /// The box of the newest key.
    signed: Signed<KeyBox>,
    /// Arrival time of the newest key.
    since: u64,
    before: Option<(u32, EpochKey)>,
}

impl KeyStore {
    pub fn new(name: Name, reader: &Identity) -> Self {
        Self { name, reader: reader.name(), box_key: reader.box_key().clone(), writers: HashMap::new() }
    }

    /// Opens a box of `writer`, which has the key `writer_key` and may write the name. Returns
    /// `None` if the key is already known.
    pub fn take(
        &mut self,
        now: u64,
        writer: Name,
        writer_key: &VerifyKey,
        signed: &Signed<KeyBox>,
    ) -> Result<Option<Opened>, StoreError> {
        let for_us = (self.reader, &self.box_key);
        let (epoch, key) = keys::open(signed, self.name, (writer, writer_key), for_us)?;
        let opened = |dropped| Ok(Some(Opened { epoch, key: key.clone(), dropped }));
        let Some(kept) = self.writers.get_mut(&writer) else {
            if self.writers.len() == MAX_WRITERS {
                return Err(StoreError::TooManyWriters);
            }
            let (newest, signed) = ((epoch, key.clone()), signed.clone());
            self.writers.insert(writer, CachedKey { newest, signed, since: now, before: None });
            return opened(None);
        };
        let known = kept.before.iter_mut().chain([&mut kept.newest]).find(|known| known.0 == epoch);
        if let Some((_, known)) = known {
            if crypto::same_secret(known.as_bytes(), key.as_bytes()) {
                return Ok(None);
            }
            *known = key.clone();
            return opened(None);
        }
        let newest = kept.newest.0;
        if epoch > newest {
            let before = std::mem::replace(&mut kept.newest, (epoch, key.clone()));
            (kept.since, kept.signed) = (now, signed.clone());
            let dropped = kept.before.replace(before);
            return opened(dropped.map(|(epoch, _)| epoch));
        }
        // Boxes may arrive in any order, especially the first ones. Much later, an older box is a
        // replay.
        let is_before = kept.before.as_ref().is_none_or(|(before, _)| *before < epoch);
        if !is_before || is_over(now, kept.since) {
            return Err(StoreError::Over { epoch, newest });
        }
        let dropped = kept.before.replace((epoch, key.clone()));
        opened(dropped.map(|(epoch, _)| epoch))
    }

    /// Wipes keys of expired epochs. Returns their writers and numbers. The caller must call this
    /// every few seconds.
    pub fn expire(&mut self, now: u64) -> Vec<(Name, u32)> {
        let over = |(writer, kept): (&Name, &mut CachedKey)| {
            let (epoch, _) = kept.before.take_if(|_| is_over(now, kept.since))?;
            Some((*writer, epoch))
        };
        self.writers.iter_mut().filter_map(over).collect()
    }

    /// Returns the box of the newest key of a writer.
    pub fn newest(&self, writer: &Name) -> Option<&Signed<KeyBox>> {
        self.writers.get(writer).map(|kept| &kept.signed)
    }

    /// Returns the newest epoch of a writer.
    pub fn newest_epoch(&self, writer: &Name) -> Option<u32> {
        self.writers.get(writer).map(|kept| kept.newest.0)
    }

    /// Wipes the keys of a writer that no longer writes.
    pub fn forget(&mut self, writer: &Name) {
        self.writers.remove(writer);
    }
}

fn is_over(now: u64, since: u64) -> bool {
    now.checked_sub(since).is_some_and(|passed| u128::from(passed) >= GRACE.as_nanos())
}

impl fmt::Debug for KeyStore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "KeyStore({:#}, {} writers)", self.name, self.writers.len())
    }
}
