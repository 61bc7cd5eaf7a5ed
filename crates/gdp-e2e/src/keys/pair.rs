//! Sealed feedback between two entities. Both derive the key from their box keys without exchanging
//! a message. `docs/wire-format.md`, "Feedback", specifies the encoding.
//!
//! Each side seals in its own sessions with random identifiers. Neither a restart nor the other
//! direction therefore repeats a nonce. An opener accepts a new session if its first message opens.
//! It accepts each message of a remembered session once.

use std::collections::VecDeque;
use std::fmt;

use zeroize::Zeroizing;

use crate::feedback_wire::{Feedback, FeedbackError, MAX_FEEDBACK};
use crate::seal::ReplayWindow;
use gdp_core::crypto;
use gdp_core::crypto::{Aead, Backend, CryptoError, NONCE_LEN, PUBLIC_KEY_LEN, TAG_LEN};
use gdp_core::keys::BoxKey;
use gdp_core::name::Name;

/// The largest payload of a frame with feedback, in bytes. It fits every link.
pub const MAX_PAIR_PAYLOAD: usize = HEADER_LEN + MAX_FEEDBACK + TAG_LEN;

const PAIR_CONTEXT: &[u8] = b"gdp/pair/1";
const SESSION_CONTEXT: &[u8] = b"gdp/pair-session/1";
/// The first byte of each frame of feedback. The highest bit tells feedback from sealed segments.
pub const VERSION: u8 = 0x82;
const HEADER_LEN: usize = 1 + 8 + 8;

/// Maximum number of messages of a session; then the sealer starts another.
const MESSAGES: u64 = 1 << 32;

/// Number of accepted sessions of the peer: the current one, and previous ones for late or repeated
/// messages from before a restart.
const SESSIONS: usize = 4;

/// Number of remembered sessions that were dropped and are no longer accepted.
const RETIRED: usize = 256;

/// The shared secret of two entities. Each clone is an independent copy and is zeroized when
/// dropped.
#[derive(Clone)]
pub struct PairKey {
    secret: Zeroizing<[u8; 32]>,
    own: Name,
    peer: Name,
}

/// The reason that a payload is not valid feedback of the peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PairError {
    #[error("{0} bytes are too few or too many for feedback")]
    Length(usize),
    #[error("feedback of version {0}, which this one does not know")]
    Version(u8),
    #[error("the peer has not sealed this for us, or it was changed")]
    Forged,
    #[error("this was received before, or so long ago that nobody knows")]
    Replayed,
    #[error(transparent)]
    Feedback(#[from] FeedbackError),
    #[error(transparent)]
    Crypto(CryptoError),
}

impl PairKey {
    /// Derives the key: `HKDF-SHA256(ECDH, info = "gdp/pair/1" ‖ lower name ‖ higher name)`.
    pub fn new(own: (Name, &BoxKey), peer: (Name, &[u8; PUBLIC_KEY_LEN])) -> Result<Self, CryptoError> {
        let (own, own_key) = own;
        let (peer, peer_key) = peer;
        let shared = own_key.agree(peer_key)?;
        let (lower, higher) = (own.min(peer), own.max(peer));
        let info = [PAIR_CONTEXT, lower.as_bytes(), higher.as_bytes()];
        Ok(Self { secret: crypto::hkdf_sha256(&[], shared.as_slice(), &info)?, own, peer })
    }

    /// Returns a sealer for messages to the peer.
    pub fn sealer(&self) -> Result<PairSealer, CryptoError> {
        self.sealer_in(crypto::random()?)
    }

    /// Returns a sealer with a given session. Reusing a session repeats nonces.
    pub(super) fn sealer_in(&self, session: [u8; 8]) -> Result<PairSealer, CryptoError> {
        let aead = self.session_aead(session, &self.own, &self.peer)?;
        Ok(PairSealer { key: self.clone(), session, aead, next: 1 })
    }

    /// Returns an opener for messages from the peer.
    pub fn opener(&self) -> PairOpener {
        PairOpener { key: self.clone(), sessions: Vec::new(), retired: VecDeque::new() }
    }

    /// Derives the AEAD of a session:
    ///
    /// `HKDF-SHA256(pair key, salt = session, info = "gdp/pair-session/1" ‖ sender ‖
    /// receiver)`.
    fn session_aead(&self, session: [u8; 8], sender: &Name, receiver: &Name) -> Result<Aead, CryptoError> {
        let info = [SESSION_CONTEXT, sender.as_bytes(), receiver.as_bytes()];
        // Reports are few and small.
        Backend::RustCrypto.aead(&*crypto::hkdf_sha256(&session, self.secret.as_slice(), &info)?)
    }
}

/// Seals messages from one entity to the other.
pub struct PairSealer {
    key: PairKey,
    session: [u8; 8],
    aead: Aead,
    /// The counter of the next message; the first is 1.
    next: u64,
}

impl PairSealer {
    /// Seals messages of at most [`MAX_FEEDBACK`] bytes into the payload of a frame to the peer.
    /// Replaces the contents of `out`; after an error `out` is empty.
    pub fn seal(&mut self, feedback: &[Feedback], out: &mut Vec<u8>) -> Result<(), PairError> {
        out.clear();
        if self.next > MESSAGES {
            *self = self.key.sealer().map_err(PairError::Crypto)?;
        }
        let header = PairHeader { session: self.session, counter: self.next };
        // Advanced before sealing, so that no nonce is reused after a failure below.
        self.next += 1;
        let result = self.seal_behind(header, feedback, out);
        if result.is_err() {
            out.clear();
        }
        result
    }

    fn seal_behind(&self, header: PairHeader, feedback: &[Feedback], out: &mut Vec<u8>) -> Result<(), PairError> {
        let clear = header.to_bytes();
        out.extend_from_slice(&clear);
        for message in feedback {
            message.encode(out)?;
        }
        if !(HEADER_LEN + 1..=HEADER_LEN + MAX_FEEDBACK).contains(&out.len()) {
            return Err(PairError::Length(out.len()));
        }
        let tag = self.aead.seal(&header.nonce(), &clear, &mut out[HEADER_LEN..]).map_err(PairError::Crypto)?;
        out.extend_from_slice(&tag);
        Ok(())
    }
}

/// Opens messages from the other entity.
pub struct PairOpener {
    key: PairKey,
    /// Sessions by last use, the most recent at the end.
    sessions: Vec<PairSession>,
    retired: VecDeque<[u8; 8]>,
}

struct PairSession {
    id: [u8; 8],
    aead: Aead,
    window: ReplayWindow,
}

impl PairOpener {
    /// Returns the sender's session of a payload, which [`Self::open`] authenticates. A sender has
    /// another one after a restart.
    pub fn session(payload: &[u8]) -> Option<[u8; 8]> {
        PairHeader::from_bytes(payload.first_chunk()?).ok().map(|header| header.session)
    }

    /// Returns the messages in the payload of a frame from the peer.
    pub fn open(&mut self, payload: &[u8]) -> Result<Vec<Feedback>, PairError> {
        if !(HEADER_LEN + TAG_LEN..=MAX_PAIR_PAYLOAD).contains(&payload.len()) {
            return Err(PairError::Length(payload.len()));
        }
        let length = PairError::Length(payload.len());
        let (clear, sealed) = payload.split_first_chunk().ok_or(length)?;
        let (ciphertext, tag) = sealed.split_last_chunk().ok_or(length)?;
        let header = PairHeader::from_bytes(clear)?;
        let known = self.sessions.iter().position(|session| session.id == header.session);
        let mut session = match known {
            Some(at) => {
                self.sessions[at].window.check(header.counter).map_err(|_| PairError::Replayed)?;
                self.sessions.remove(at)
            }
            None if self.retired.contains(&header.session) => return Err(PairError::Replayed),
            None => PairSession::new(&self.key, header.session).map_err(PairError::Crypto)?,
        };
        let mut plaintext = vec![0; ciphertext.len()];
        let opened = session.aead.open(&header.nonce(), clear, ciphertext, tag, &mut plaintext);
        if opened.is_ok() {
            session.window.record(header.counter);
        }
        match known {
            // A forged message does not refresh a session.
            Some(at) if opened.is_err() => self.sessions.insert(at, session),
            None if opened.is_err() => {}
            _ => self.keep(session),
        }
        opened.map_err(|_| PairError::Forged)?;
        Ok(Feedback::decode_all(&plaintext)?)
    }

    /// Adds a session as the most recent one, and drops the least recent one if there are too many.
    fn keep(&mut self, session: PairSession) {
        if self.sessions.len() == SESSIONS {
            if self.retired.len() == RETIRED {
                self.retired.pop_front();
            }
            self.retired.push_back(self.sessions.remove(0).id);
        }
        self.sessions.push(session);
    }
}

impl PairSession {
    fn new(key: &PairKey, id: [u8; 8]) -> Result<Self, CryptoError> {
        Ok(Self { id, aead: key.session_aead(id, &key.peer, &key.own)?, window: ReplayWindow::default() })
    }
}

#[derive(Clone, Copy)]
struct PairHeader {
    session: [u8; 8],
    counter: u64,
}

impl PairHeader {
    fn to_bytes(self) -> [u8; HEADER_LEN] {
        let mut bytes = [0; HEADER_LEN];
        bytes[0] = VERSION;
        bytes[1..9].copy_from_slice(&self.session);
        bytes[9..].copy_from_slice(&self.counter.to_be_bytes());
        bytes
    }

    fn from_bytes(bytes: &[u8; HEADER_LEN]) -> Result<Self, PairError> {
        let [version, session @ .., c0, c1, c2, c3, c4, c5, c6, c7] = *bytes;
        match version {
            VERSION => Ok(Self { session, counter: u64::from_be_bytes([c0, c1, c2, c3, c4, c5, c6, c7]) }),
            version => Err(PairError::Version(version)),
        }
    }

    fn nonce(self) -> [u8; NONCE_LEN] {
        let mut nonce = [0; NONCE_LEN];
        nonce[4..].copy_from_slice(&self.counter.to_be_bytes());
        nonce
    }
}

impl fmt::Debug for PairKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PairKey({:#} and {:#})", self.own, self.peer)
    }
}

impl fmt::Debug for PairSealer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PairSealer({:?}, session {}, next {})", self.key, hex::encode(self.session), self.next)
    }
}

impl fmt::Debug for PairOpener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PairOpener({:?}, {} sessions)", self.key, self.sessions.len())
    }
}

#[cfg(test)]
#[path = "../../tests/unit/keys/pair.rs"]
mod tests;
