//! The keys of a link's data frames, and the ratchet that replaces them without interrupting
//! traffic.
//!
//! Pure: time, counts and answers are inputs; keys and messages to the peer are outputs.
//! [`super::rekey`] does the I/O.
//!
//! Each direction has its own chain. `secret 0` comes from the TLS exporter. Generation *n* has
//!
//! ```text
//! key n        = HKDF-SHA256(secret n, "gdp/link-key/1")         16 bytes of 32
//! secret n + 1 = HKDF-SHA256(secret n, "gdp/link-secret/1")
//! ```
//!
//! A frame carries the lowest bit of its key's generation. Both ends store two keys: that of the
//! generation in use and its successor or, for a short time, its predecessor. The sender therefore
//! moves to the next generation without prior agreement.
//!
//! The sender then announces the change to the receiver. The receiver waits until no frame under
//! the old key can still be in flight. It replaces the old key with the key after next, and only
//! then answers. Before that answer, the sender does not move again. An announcement, an answer or
//! the daemon may be lost while the kernel continues to forward. The receiver has the key of
//! arriving frames even then.

use std::time::{Duration, Instant};

use gdp_wire::LinkEntry;
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use gdp_core::crypto::{self, CryptoError};

const KEY_CONTEXT: &[u8] = b"gdp/link-key/1";
const SECRET_CONTEXT: &[u8] = b"gdp/link-secret/1";

/// Delay before the sender repeats an announcement that was refused or not answered.
const ANNOUNCE_AGAIN: Duration = Duration::from_secs(1);

/// Interval at which the count of frames is checked.
const LOOK_AT_COUNT: Duration = Duration::from_secs(10);

/// The schedule for replacing a link's keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RekeySchedule {
    /// Time after which a sender replaces its key. The default is one hour. Keys are in kernel maps
    /// that tools can print, whereas the secrets they derive from are only in the daemon. An
    /// attacker who has read a key can use it until the second change after that.
    pub interval: Duration,
    /// Number of frames after which a sender replaces its key. The default is 2³²: each value of
    /// the 32-bit count in frames then occurs once under a key. SipHash tolerates far more: what a
    /// tag reveals of its state does not collide before 2⁶⁴.
    pub frames: u64,
    /// Time for which a receiver still accepts the old key after the announcement of the new one.
    /// It exceeds the longest delay of a frame in a network that still delivers it. It also exceeds
    /// the time for which a sender is interrupted between tagging and sending a frame.
    pub overlap: Duration,
}

impl Default for RekeySchedule {
    fn default() -> Self {
        Self { interval: Duration::from_secs(3600), frames: 1 << 32, overlap: Duration::from_secs(2) }
    }
}

/// A snapshot of a link's keys for data planes. Its keys are cleared when it is dropped; the
/// `Debug` form omits them.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
#[cfg_attr(test, derive(PartialEq, Eq))]
pub struct LinkKeys {
    rx_keys: [TagKey; 2],
    tx_keys: [TagKey; 2],
    tx_phase: u32,
}

type TagKey = [u64; 2];

impl LinkKeys {
    /// Writes the keys into a link's entry. Of the words that concurrent tagging reads, only the
    /// phase changes.
    pub fn put(&self, entry: &mut LinkEntry) {
        entry.rx_keys = self.rx_keys;
        entry.tx_keys = self.tx_keys;
        entry.tx_phase = self.tx_phase;
    }
}

impl std::fmt::Debug for LinkKeys {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "LinkKeys(phase {})", self.tx_phase)
    }
}

/// An action for the caller after [`Ratchet::keys`] are in the tables of all data planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RekeyStep {
    /// Announce to the peer that frames now use the key of this generation. Pass the peer's answer
    /// to [`Ratchet::answered`].
    Announce(u64),
    /// Answer the peer's announcement: the successor of the announced generation is installed.
    Confirm,
}

/// The outcome of a peer's announcement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnnouncementOutcome {
    /// Not yet decided: [`RekeyStep::Confirm`] follows.
    Later,
    /// Already processed: answer as before.
    Known,
    /// Refuse: the peer cannot have moved to this generation.
    Impossible,
}

/// Both directions of a link, as seen by one side.
pub struct Ratchet {
    schedule: RekeySchedule,
    rx: Rx,
    tx: Tx,
}

struct Rx {
    secret: TrafficSecret,
    /// The last generation that the peer has announced, or the first.
    generation: u64,
    /// The time at which the key before the announced one is replaced.
    retires: Option<Instant>,
}

struct Tx {
    secret: TrafficSecret,
    /// The generation in use.
    generation: u64,
    /// The time and the count at which this generation started.
    since: (Instant, u64),
    announced: Announced,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Announced {
    /// The peer has answered, or no answer is outstanding.
    Confirmed,
    /// The announcement is sent, and the peer has not answered.
    Asked,
    /// The announcement is due, possibly again, at this time.
    Due(Instant),
}

impl Ratchet {
    /// Derives a link's first keys from the secrets of both directions.
    pub fn new(
        rx_secret: Zeroizing<[u8; 32]>,
        tx_secret: Zeroizing<[u8; 32]>,
        schedule: RekeySchedule,
        now: Instant,
    ) -> Result<Self, CryptoError> {
        let rx = Rx { secret: TrafficSecret::new(rx_secret)?, generation: 0, retires: None };
        let tx = Tx {
            secret: TrafficSecret::new(tx_secret)?,
            generation: 0,
            since: (now, 0),
            announced: Announced::Confirmed,
        };
        Ok(Self { schedule, rx, tx })
    }

    pub fn keys(&self) -> LinkKeys {
        LinkKeys {
            rx_keys: *self.rx.secret.keys,
            tx_keys: *self.tx.secret.keys,
            tx_phase: (self.tx.generation % 2) as u32,
        }
    }

    /// Returns the generations of the receive key and the send key.
    pub fn generations(&self) -> (u64, u64) {
        (self.rx.generation, self.tx.generation)
    }

    /// Returns the next step that follows from the time and the count `sent` of frames. Call until
    /// it returns `None`, and again at [`Self::wake_at`].
    pub fn poll(&mut self, now: Instant, sent: u64) -> Result<Option<RekeyStep>, CryptoError> {
        if self.rx.retires.take_if(|retires| *retires <= now).is_some() {
            self.rx.secret.replace(self.rx.generation + 1)?;
            return Ok(Some(RekeyStep::Confirm));
        }
        let tx = &mut self.tx;
        match tx.announced {
            Announced::Confirmed => {
                let (since, count) = tx.since;
                let is_over =
                    now >= since + self.schedule.interval || sent.saturating_sub(count) >= self.schedule.frames;
                if !is_over {
                    return Ok(None);
                }
                tx.generation += 1;
                tx.since = (now, sent);
            }
            Announced::Due(at) if at <= now => {}
            Announced::Asked | Announced::Due(_) => return Ok(None),
        }
        tx.announced = Announced::Asked;
        Ok(Some(RekeyStep::Announce(tx.generation)))
    }

    /// Returns the time at which to call [`Self::poll`] at the latest.
    pub fn wake_at(&self, now: Instant) -> Instant {
        let tx = match self.tx.announced {
            Announced::Confirmed => (self.tx.since.0 + self.schedule.interval).min(now + LOOK_AT_COUNT),
            Announced::Asked => now + LOOK_AT_COUNT,
            Announced::Due(at) => at,
        };
        self.rx.retires.map_or(tx, |retires| retires.min(tx))
    }

    /// Processes the outcome of an announcement: confirmed, or else refused or unanswered. Returns
    /// whether keys changed.
    pub fn answered(&mut self, confirmed: bool, now: Instant) -> Result<bool, CryptoError> {
        if self.tx.announced != Announced::Asked {
            return Ok(false);
        }
        if confirmed {
            self.tx.secret.replace(self.tx.generation + 1)?;
            self.tx.announced = Announced::Confirmed;
        } else {
            self.tx.announced = Announced::Due(now + ANNOUNCE_AGAIN);
        }
        Ok(confirmed)
    }

    /// Processes the peer's announcement that its frames now use the key of this generation.
    pub fn announced(&mut self, generation: u64, now: Instant) -> AnnouncementOutcome {
        let rx = &mut self.rx;
        if Some(generation) == rx.generation.checked_add(1) && rx.retires.is_none() {
            rx.generation = generation;
            rx.retires = Some(now + self.schedule.overlap);
        }
        match generation == rx.generation {
            true if rx.retires.is_some() => AnnouncementOutcome::Later,
            _ if generation <= rx.generation => AnnouncementOutcome::Known,
            _ => AnnouncementOutcome::Impossible,
        }
    }
}

/// Two consecutive keys, indexed by phase, and the secret of later ones. Used secrets are cleared.
struct TrafficSecret {
    keys: Zeroizing<[TagKey; 2]>,
    next: Zeroizing<[u8; 32]>,
}

impl TrafficSecret {
    fn new(secret: Zeroizing<[u8; 32]>) -> Result<Self, CryptoError> {
        let mut secret = Self { keys: Zeroizing::new([[0; 2]; 2]), next: secret };
        secret.replace(0)?;
        secret.replace(1)?;
        Ok(secret)
    }

    /// Derives the next key of the chain, which has this generation. It replaces the key of two
    /// generations before.
    fn replace(&mut self, generation: u64) -> Result<(), CryptoError> {
        let key = derive(&self.next, KEY_CONTEXT)?;
        self.next = derive(&self.next, SECRET_CONTEXT)?;
        let (words, _) = key.as_chunks();
        self.keys[(generation % 2) as usize] = [u64::from_le_bytes(words[0]), u64::from_le_bytes(words[1])];
        Ok(())
    }
}

fn derive(secret: &[u8; 32], context: &[u8]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
    crypto::hkdf_sha256(&[], secret, &[context])
}

#[cfg(test)]
#[path = "../../tests/unit/link/ratchet.rs"]
mod tests;
