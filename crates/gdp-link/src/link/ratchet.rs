//! The keys of a link's data frames, and how each follows from the one before while frames go on.
//! Pure: time, counts and answers come in, keys and what to tell the peer come out;
//! [`super::rekey`] is the shell around it.
//!
//! Each direction has a chain of its own: `secret 0` is from the TLS exporter, and generation *n*
//! has
//!
//! ```text
//! key n        = HKDF-SHA256(secret n, "gdp/link-key/1")         16 bytes of 32
//! secret n + 1 = HKDF-SHA256(secret n, "gdp/link-secret/1")
//! ```
//!
//! A frame says the lowest bit of its key's generation, and both ends hold two keys: that of the
//! generation in use and its successor (or, for a moment, its predecessor). So the sender moves on
//! by itself and nothing has to be agreed upon first. It then tells the receiver, which waits until
//! no frame under the old key can be on its way, puts the key after next in the place of the old
//! one, and only then answers; before it has, the sender does not move again. Whatever is lost on
//! the way (an announcement, an answer, a daemon whose kernel forwards on), the key that frames
//! leave under is held by the receiver.

use std::time::{Duration, Instant};

use gdp_wire::LinkEntry;
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use gdp_core::crypto::{Backend, CryptoError};

const KEY_CONTEXT: &[u8] = b"gdp/link-key/1";
const SECRET_CONTEXT: &[u8] = b"gdp/link-secret/1";

/// Between an announcement that was refused or not answered and the next.
const ANNOUNCE_AGAIN: Duration = Duration::from_secs(1);

/// How often the count of frames is looked at.
const LOOK_AT_COUNT: Duration = Duration::from_secs(10);

/// When a link's keys are replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RekeySchedule {
    /// After this time a sender moves on. An hour: keys are in kernel maps that tools can print,
    /// whereas the secrets they come from are in the daemon alone; who has seen a key can use it
    /// until the second change after.
    pub interval: Duration,
    /// Or after this many frames. 2³²: so the count that frames carry, of 32 bits, comes once under
    /// a key. SipHash would bear far more, as what a tag shows of its state does not collide before
    /// 2⁶⁴.
    pub frames: u64,
    /// How long a receiver still takes frames under the old key once it was told of the new one:
    /// longer than any network holds a frame back that it delivers at all, and than a sender is
    /// interrupted between tagging a frame and sending it.
    pub overlap: Duration,
}

impl Default for RekeySchedule {
    fn default() -> Self {
        Self { interval: Duration::from_secs(3600), frames: 1 << 32, overlap: Duration::from_secs(2) }
    }
}

/// What data planes need of a link's keys at a moment. Cleared when dropped; the `Debug` form
/// leaves them out.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
#[cfg_attr(test, derive(PartialEq, Eq))]
pub struct LinkKeys {
    rx_keys: [TagKey; 2],
    tx_keys: [TagKey; 2],
    tx_phase: u32,
}

type TagKey = [u64; 2];

impl LinkKeys {
    /// Writes them into a link's entry. Of the words that frames are tagged with meanwhile none
    /// changes but the phase.
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

/// To be done after [`Ratchet::keys`] are in the tables of all data planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RekeyStep {
    /// Tell the peer that frames now leave under the key of this generation; [`Ratchet::answered`]
    /// takes its answer.
    Announce(u64),
    /// Answer the peer's announcement: the successor of the generation it told of is held.
    Confirm,
}

/// What an announcement of the peer is answered with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnnouncementOutcome {
    /// Nothing yet: [`RekeyStep::Confirm`] comes.
    Later,
    /// The same as before.
    Known,
    /// A refusal: it cannot have moved there.
    Impossible,
}

/// Both directions of a link, on one side.
pub struct Ratchet {
    schedule: RekeySchedule,
    rx: Rx,
    tx: Tx,
}

struct Rx {
    secret: TrafficSecret,
    /// The generation that the peer is known to have moved to, or the first.
    generation: u64,
    /// When the key before the one announced goes.
    retires: Option<Instant>,
}

struct Tx {
    secret: TrafficSecret,
    /// The generation in use.
    generation: u64,
    /// Since when, and at which count.
    since: (Instant, u64),
    announced: Announced,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Announced {
    /// The peer has answered, or need not.
    Confirmed,
    /// The peer was told, and has not answered.
    Asked,
    /// It is to be told (again) then.
    Due(Instant),
}

impl Ratchet {
    /// A link's first keys, from the secrets of both directions.
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

    /// The generations of frames that arrive and of those that leave.
    pub fn generations(&self) -> (u64, u64) {
        (self.rx.generation, self.tx.generation)
    }

    /// What time, and the count of frames `sent`, bring about. To be asked until there is nothing,
    /// and again at [`Self::wake_at`].
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

    /// When [`Self::poll`] may have something, at the latest.
    pub fn wake_at(&self, now: Instant) -> Instant {
        let tx = match self.tx.announced {
            Announced::Confirmed => (self.tx.since.0 + self.schedule.interval).min(now + LOOK_AT_COUNT),
            Announced::Asked => now + LOOK_AT_COUNT,
            Announced::Due(at) => at,
        };
        self.rx.retires.map_or(tx, |retires| retires.min(tx))
    }

    /// The peer has answered the announcement (`confirmed`), or refused it, or has not answered.
    /// True if keys changed.
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

    /// The peer says that its frames now leave under the key of this generation.
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

/// Two keys in a row, by phase, and what those after them come from. Secrets that were used are
/// gone.
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

    /// Takes the next key of the chain, of this generation, in the place of the one two before.
    fn replace(&mut self, generation: u64) -> Result<(), CryptoError> {
        let key = derive(&self.next, KEY_CONTEXT)?;
        self.next = derive(&self.next, SECRET_CONTEXT)?;
        let (words, _) = key.as_chunks();
        self.keys[(generation % 2) as usize] = [u64::from_le_bytes(words[0]), u64::from_le_bytes(words[1])];
        Ok(())
    }
}

fn derive(secret: &[u8; 32], context: &[u8]) -> Result<Zeroizing<[u8; 32]>, CryptoError> {
    Backend::default().hkdf_sha256(&[], secret, &[context])
}

#[cfg(test)]
#[path = "../../tests/unit/link/ratchet.rs"]
mod tests;
