//! A writer's keys for one name: the current epoch, the start of the next one, and the key boxes
//! for readers.
//!
//! An epoch ends by age, messages or bytes ([`Rotation`]), or when a reader with a box of it is
//! revoked. Its successor has its own number from the start. The writer uses it only when all its
//! boxes are stored where readers find them, or after [`HANDOVER`]. A reader therefore has the key
//! before the first message. A slow or absent reader cannot keep a revoked reader reading.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use gdp_core::cert::{CertError, Signed};
use gdp_core::crypto::{CryptoError, PUBLIC_KEY_LEN};
use gdp_core::identity::{Identity, VerifyKey};
use gdp_core::keys::{self, EpochKey, KeyBox};
use gdp_core::name::Name;

/// Maximum number of readers of a name that one writer wraps keys for.
pub const MAX_READERS: usize = 1024;

/// Maximum number of boxes in one batch. They take some 10 ms to make, in which the writer seals
/// nothing.
const MAX_BOXES: usize = 16;

/// Maximum time that an epoch waits for its boxes to be stored before it is used.
const HANDOVER: Duration = Duration::from_secs(2);

/// Minimum interval between the starts of two epochs. Epoch numbers are Unix seconds, so they never
/// run ahead of the clock and a restarted writer does not repeat one. The interval also limits the
/// wrapping work if readers are revoked one by one.
const BETWEEN_EPOCHS: Duration = Duration::from_secs(1);

/// The limits that replace the key of a name without a revocation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rotation {
    pub age: Duration,
    pub messages: u64,
    pub bytes: u64,
}

impl Default for Rotation {
    /// An hour, 2²⁶ messages, or 2³⁶ bytes, which are 2³² blocks of AES. Up to these
    /// limits, GCM leaks information with a probability below 2⁻⁶⁴.
    fn default() -> Self {
        Self { age: Duration::from_secs(3600), messages: 1 << 26, bytes: 1 << 36 }
    }
}

/// Boxes to store with the writer's advertisement: at most 64, all of one epoch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Boxes {
    pub epoch: u32,
    pub boxes: Vec<Signed<KeyBox>>,
}

/// The reason that no key is wrapped for a reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Omission {
    #[error("its box key is not a point on the curve; it must advertise another")]
    BadBoxKey,
    #[error("the name has {MAX_READERS} other readers already; use another name for some of them")]
    TooMany,
}

/// The reason that a ring cannot make new keys. The existing keys remain in use.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RingError {
    #[error("no epoch can follow number {}; check the clock", u32::MAX)]
    NoMoreEpochs,
    #[error(transparent)]
    Crypto(#[from] CryptoError),
    #[error("a key box could not be made: {0}")]
    Box(#[from] CertError),
}

/// The keys of one writer for one name.
pub struct KeyRing {
    name: Name,
    writer: Identity,
    rotation: Rotation,
    /// The readers that need boxes, with box keys that are points on the curve.
    readers: BTreeMap<Name, [u8; PUBLIC_KEY_LEN]>,
    current: Epoch,
    /// The next epoch, which is used when its boxes are stored.
    next: Option<Epoch>,
    /// The highest epoch that a reader has shown to be of an earlier run.
    earlier: u32,
}

struct Epoch {
    number: u32,
    key: EpochKey,
    began: u64,
    /// Readers with a box.
    holders: BTreeMap<Name, Holder>,
    /// Whether a reader with a box has been revoked.
    stale: bool,
    /// Number of batches of boxes that were returned but not confirmed as stored.
    unstored: usize,
    messages: u64,
    bytes: u64,
}

struct Holder {
    box_key: [u8; PUBLIC_KEY_LEN],
    /// Whether the box must be made again.
    lost: bool,
}

impl KeyRing {
    /// Starts an epoch without any boxes.
    pub fn new(name: Name, writer: &Identity, rotation: Rotation, now: u64) -> Result<Self, RingError> {
        let current = Epoch::begin(0, now)?;
        Ok(Self { name, writer: writer.clone(), rotation, readers: BTreeMap::new(), current, next: None, earlier: 0 })
    }

    /// Sets the authorised readers by name and box key (SEC1 compressed), most important first.
    /// Returns the readers without a wrapped key, with the reason. [`Self::poll`] then returns the
    /// resulting boxes.
    pub fn set_readers(&mut self, readers: &[(Name, [u8; PUBLIC_KEY_LEN])]) -> Vec<(Name, Omission)> {
        let mut omitted = Vec::new();
        let mut kept = BTreeMap::new();
        for &(reader, box_key) in readers {
            // Most readers are already known, and validating a point is expensive.
            let known = self.readers.get(&reader) == Some(&box_key);
            if !known && VerifyKey::from_bytes(&box_key).is_err() {
                omitted.push((reader, Omission::BadBoxKey));
            } else if kept.len() == MAX_READERS && !kept.contains_key(&reader) {
                omitted.push((reader, Omission::TooMany));
            } else {
                kept.insert(reader, box_key);
            }
        }
        self.readers = kept;
        for epoch in self.next.iter_mut().chain([&mut self.current]) {
            let holders = epoch.holders.len();
            epoch.holders.retain(|holder, _| self.readers.contains_key(holder));
            epoch.stale |= epoch.holders.len() < holders;
        }
        omitted
    }

    /// Processes the newest box that a reader holds of this writer. If this writer's own signature
    /// proves that an earlier run used a higher epoch, another epoch follows that one. This happens
    /// after a restart with a clock that was set back. Returns whether there is such an epoch.
    pub fn take_newest(&mut self, reader: &Name, signed: &Signed<KeyBox>) -> bool {
        let Ok(KeyBox { name, writer, reader: of, epoch, .. }) = signed.claims_unverified() else { return false };
        let is_news = epoch > self.latest().number.max(self.earlier) && self.readers.contains_key(reader);
        let is_own = (name, writer, of) == (self.name, self.writer.name(), *reader);
        if !is_news || !is_own || signed.verify_signature(&self.writer.key().verify_key()).is_err() {
            return false;
        }
        self.earlier = epoch;
        self.next.as_mut().unwrap_or(&mut self.current).stale = true;
        true
    }

    /// Records the messages sealed under the current epoch's key since the last call, and their
    /// bytes on the wire.
    pub fn used(&mut self, messages: u64, bytes: u64) {
        let current = &mut self.current;
        current.messages = current.messages.saturating_add(messages);
        current.bytes = current.bytes.saturating_add(bytes);
    }

    /// Returns the epoch for sealing and its key. Changes only in [`Self::poll`] and
    /// [`Self::boxes_stored`].
    pub fn current(&self) -> (u32, &EpochKey) {
        (self.current.number, &self.current.key)
    }

    /// Returns boxes to store, if there are any. The caller must poll until `None`, again at
    /// [`Self::wake_at`], and when the readers change. The caller must retry until the boxes are
    /// stored.
    pub fn poll(&mut self, now: u64) -> Result<Option<Boxes>, RingError> {
        self.advance(now)?;
        for epoch in self.next.iter_mut().chain([&mut self.current]) {
            let boxes = epoch.wrap(self.name, &self.writer, &self.readers)?;
            if boxes.is_some() {
                return Ok(boxes);
            }
        }
        Ok(None)
    }

    /// Records that one [`Boxes`] of this epoch is stored. The last one puts an epoch into use.
    pub fn boxes_stored(&mut self, epoch: u32) {
        for known in self.next.iter_mut().chain([&mut self.current]).filter(|known| known.number == epoch) {
            known.unstored = known.unstored.saturating_sub(1);
        }
        self.promote_if_stored();
    }

    /// Makes [`Self::poll`] return all boxes again, because the place of storage has lost them.
    pub fn republish(&mut self) {
        for epoch in self.next.iter_mut().chain([&mut self.current]) {
            epoch.holders.values_mut().for_each(|holder| holder.lost = true);
            epoch.unstored = 0;
        }
    }

    /// Returns the latest time for the next [`Self::poll`].
    pub fn wake_at(&self) -> u64 {
        if self.next.iter().chain([&self.current]).any(|epoch| epoch.lacks_boxes(&self.readers)) {
            return 0;
        }
        let may_begin = after(self.latest().began, BETWEEN_EPOCHS);
        match &self.next {
            Some(next) if next.stale => may_begin.min(after(next.began, HANDOVER)),
            Some(next) => after(next.began, HANDOVER),
            None if self.is_due(self.current.began) => may_begin,
            None => may_begin.max(after(self.current.began, self.rotation.age)),
        }
    }

    fn advance(&mut self, now: u64) -> Result<(), RingError> {
        let ready = |next: &mut Epoch| is_over(now, next.began, HANDOVER) || next.is_stored(&self.readers);
        if let Some(next) = self.next.take_if(ready) {
            self.current = next;
        }
        if self.is_due(now) && is_over(now, self.latest().began, BETWEEN_EPOCHS) {
            let begun = Epoch::begin(self.latest().number.max(self.earlier), now)?;
            // A successor that is already stale still excludes the readers that were revoked
            // earlier.
            if let Some(next) = self.next.take() {
                self.current = next;
            }
            self.next = Some(begun);
            self.promote_if_stored();
        }
        Ok(())
    }

    /// Returns whether the latest epoch needs a successor.
    fn is_due(&self, now: u64) -> bool {
        let Epoch { began, messages, bytes, .. } = self.current;
        let Rotation { age, messages: most_messages, bytes: most_bytes } = self.rotation;
        let is_used_up = messages >= most_messages || bytes >= most_bytes || is_over(now, began, age);
        self.latest().stale || (self.next.is_none() && is_used_up)
    }

    fn promote_if_stored(&mut self) {
        if let Some(next) = self.next.take_if(|next| next.is_stored(&self.readers)) {
            self.current = next;
        }
    }

    fn latest(&self) -> &Epoch {
        self.next.as_ref().unwrap_or(&self.current)
    }
}

impl Epoch {
    /// Starts the epoch after number `last`. Its number is the Unix second, or `last` + 1 if that
    /// is higher.
    fn begin(last: u32, now: u64) -> Result<Self, RingError> {
        let second = u32::try_from(now / 1_000_000_000).unwrap_or(u32::MAX);
        let number = last.checked_add(1).ok_or(RingError::NoMoreEpochs)?.max(second);
        let (key, holders) = (EpochKey::generate()?, BTreeMap::new());
        Ok(Self { number, key, began: now, holders, stale: false, unstored: 0, messages: 0, bytes: 0 })
    }

    /// Returns boxes for some of the readers that lack one.
    fn wrap(
        &mut self,
        name: Name,
        writer: &Identity,
        readers: &BTreeMap<Name, [u8; PUBLIC_KEY_LEN]>,
    ) -> Result<Option<Boxes>, RingError> {
        let lacking: Vec<_> = readers.iter().filter(|reader| self.lacks_box(reader)).take(MAX_BOXES).collect();
        if lacking.is_empty() {
            return Ok(None);
        }
        let wrap =
            |&(reader, box_key): &(&Name, &_)| keys::wrap(name, writer, (*reader, box_key), self.number, &self.key);
        let boxes = lacking.iter().map(wrap).collect::<Result<_, _>>()?;
        let given = lacking.into_iter().map(|(reader, &box_key)| (*reader, Holder { box_key, lost: false }));
        self.holders.extend(given);
        self.unstored += 1;
        Ok(Some(Boxes { epoch: self.number, boxes }))
    }

    fn lacks_box(&self, (reader, box_key): &(&Name, &[u8; PUBLIC_KEY_LEN])) -> bool {
        self.holders.get(reader).is_none_or(|holder| holder.lost || holder.box_key != **box_key)
    }

    fn lacks_boxes(&self, readers: &BTreeMap<Name, [u8; PUBLIC_KEY_LEN]>) -> bool {
        readers.iter().any(|reader| self.lacks_box(&reader))
    }

    fn is_stored(&self, readers: &BTreeMap<Name, [u8; PUBLIC_KEY_LEN]>) -> bool {
        self.unstored == 0 && !self.lacks_boxes(readers)
    }
}

/// Returns whether `time` has passed since `since`. If the clock was set back, the elapsed time is
/// unknown and counts as passed.
fn is_over(now: u64, since: u64, time: Duration) -> bool {
    now.checked_sub(since).is_none_or(|passed| u128::from(passed) >= time.as_nanos())
}

fn after(begin: u64, time: Duration) -> u64 {
    begin.saturating_add(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
}

impl fmt::Debug for KeyRing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, readers, current, next, .. } = self;
        let next = next.as_ref().map(|next| next.number);
        write!(f, "KeyRing({name:#}, {} readers, epoch {}, next {next:?})", readers.len(), current.number)
    }
}
