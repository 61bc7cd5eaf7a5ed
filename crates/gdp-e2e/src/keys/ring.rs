//! A writer's keys for one name: which epoch messages are sealed under, when another begins, and
//! who gets a box of it.
//!
//! An epoch ends by age, messages or bytes ([`Rotation`]), and when one who holds a box of it may
//! not read any more. Its successor has a number of its own from the start, but comes into use only
//! when all its boxes are stored where readers find them, or [`HANDOVER`] later: so a reader has
//! the key before the first message, and nobody who is slow or away keeps a revoked reader reading.

use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;

use gdp_core::cert::{CertError, Signed};
use gdp_core::crypto::{CryptoError, PUBLIC_KEY_LEN};
use gdp_core::identity::{Identity, VerifyKey};
use gdp_core::keys::{self, EpochKey, KeyBox};
use gdp_core::name::Name;

/// Readers of a name that one writer wraps keys to.
pub const MAX_READERS: usize = 1024;

/// Boxes handed out at once: together they fit one request of a link, and take some 10 ms to make.
const MAX_BOXES: usize = 64;

/// How long an epoch may wait for its boxes to be stored before it comes into use.
const HANDOVER: Duration = Duration::from_secs(2);

/// Between the beginnings of two epochs. As their numbers are Unix seconds and so never outrun the
/// clock, a writer that was restarted does not repeat one; and whoever revokes readers one by one
/// does not keep the writer busy with wrapping.
const BETWEEN_EPOCHS: Duration = Duration::from_secs(1);

/// When the key of a name is replaced though nobody was revoked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rotation {
    pub age: Duration,
    pub messages: u64,
    pub bytes: u64,
}

impl Default for Rotation {
    /// An hour; 2²⁶ messages; 2³⁶ bytes, which are 2³² blocks of AES: what GCM leaks by then has a
    /// probability below 2⁻⁶⁴.
    fn default() -> Self {
        Self { age: Duration::from_secs(3600), messages: 1 << 26, bytes: 1 << 36 }
    }
}

/// Boxes to be stored beside the writer's advertisement, all of one epoch: at most 64.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Boxes {
    pub epoch: u32,
    pub boxes: Vec<Signed<KeyBox>>,
}

/// Why no key is wrapped to somebody.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Omission {
    #[error("its box key is not a point on the curve; it must advertise another")]
    BadBoxKey,
    #[error("the name has {MAX_READERS} other readers already; use another name for some of them")]
    TooMany,
}

/// Why a ring has no keys any more. What it has stays in use.
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
    /// Who is to have boxes, with box keys that are points on the curve.
    readers: BTreeMap<Name, [u8; PUBLIC_KEY_LEN]>,
    current: Epoch,
    /// What comes into use when its boxes are stored.
    next: Option<Epoch>,
}

struct Epoch {
    number: u32,
    key: EpochKey,
    began: u64,
    /// Readers that were given a box.
    holders: BTreeMap<Name, Holder>,
    /// One that is no reader any more was given a box.
    stale: bool,
    /// Boxes that were handed out and, as far as is known, not stored yet: how often.
    unstored: usize,
    messages: u64,
    bytes: u64,
}

struct Holder {
    box_key: [u8; PUBLIC_KEY_LEN],
    /// The box has to be made again.
    lost: bool,
}

impl KeyRing {
    /// Begins an epoch that nobody else knows yet.
    pub fn new(name: Name, writer: &Identity, rotation: Rotation, now: u64) -> Result<Self, RingError> {
        let current = Epoch::begin(0, now)?;
        Ok(Self { name, writer: writer.clone(), rotation, readers: BTreeMap::new(), current, next: None })
    }

    /// Who may read from now on, by name and box key (SEC1 compressed), most important first.
    /// Returns those that no key is wrapped to, and why. [`Self::poll`] then has what follows.
    pub fn set_readers(&mut self, readers: &[(Name, [u8; PUBLIC_KEY_LEN])]) -> Vec<(Name, Omission)> {
        let mut omitted = Vec::new();
        let mut kept = BTreeMap::new();
        for &(reader, box_key) in readers {
            // Most were readers before; looking for the point is the dear part.
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

    /// What was sealed under the current epoch's key since the last call: messages, and their bytes
    /// on the wire.
    pub fn used(&mut self, messages: u64, bytes: u64) {
        let current = &mut self.current;
        current.messages = current.messages.saturating_add(messages);
        current.bytes = current.bytes.saturating_add(bytes);
    }

    /// The epoch that messages are sealed under, and its key. Changes in [`Self::poll`] and
    /// [`Self::boxes_stored`] only.
    pub fn current(&self) -> (u32, &EpochKey) {
        (self.current.number, &self.current.key)
    }

    /// Boxes to store, if there are any. To be asked until there are none, and again when
    /// [`Self::wake_at`] says, or when readers change. The caller offers boxes again until they are
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

    /// One [`Boxes`] of this epoch is stored. An epoch comes into use with the last of them.
    pub fn boxes_stored(&mut self, epoch: u32) {
        for known in self.next.iter_mut().chain([&mut self.current]).filter(|known| known.number == epoch) {
            known.unstored = known.unstored.saturating_sub(1);
        }
        self.promote_if_stored();
    }

    /// Who stored boxes has lost them: [`Self::poll`] makes them anew.
    pub fn republish(&mut self) {
        for epoch in self.next.iter_mut().chain([&mut self.current]) {
            epoch.holders.values_mut().for_each(|holder| holder.lost = true);
            epoch.unstored = 0;
        }
    }

    /// When [`Self::poll`] has something to do, at the latest.
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
            let begun = Epoch::begin(self.latest().number, now)?;
            // A successor that is stale already keeps out at least those that were revoked before.
            if let Some(next) = self.next.take() {
                self.current = next;
            }
            self.next = Some(begun);
            self.promote_if_stored();
        }
        Ok(())
    }

    /// Whether the epoch begun last has to have a successor.
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
    /// The one after number `last`: its number is the Unix second, if that has come.
    fn begin(last: u32, now: u64) -> Result<Self, RingError> {
        let second = u32::try_from(now / 1_000_000_000).unwrap_or(u32::MAX);
        let number = last.checked_add(1).ok_or(RingError::NoMoreEpochs)?.max(second);
        let (key, holders) = (EpochKey::generate()?, BTreeMap::new());
        Ok(Self { number, key, began: now, holders, stale: false, unstored: 0, messages: 0, bytes: 0 })
    }

    /// Boxes for some of those readers that have none.
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

/// Whether `time` has passed since then. It has, if the clock was set back: then nobody knows.
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
