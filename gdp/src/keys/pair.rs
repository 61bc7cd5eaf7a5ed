//! What two entities tell each other alone: feedback, under a key that follows from their box keys without a message between them.
//! The bytes are specified in `docs/wire-format.md`, "Feedback".
//!
//! Each side seals in sessions of its own, with random identifiers: so neither a restart nor the other direction repeats a nonce.
//! An opener takes a session that it has not seen if what came opens; of those it remembers each message is taken once.

use std::collections::VecDeque;
use std::fmt;

use zeroize::Zeroizing;

use super::BoxKey;
use crate::crypto::{self, Aead, Backend, CryptoError, NONCE_LEN, PUBLIC_KEY_LEN, TAG_LEN};
use crate::feedback_wire::{Feedback, FeedbackError, MAX_FEEDBACK};
use crate::name::Name;
use crate::seal::Window;

/// The largest payload of a frame with feedback, in bytes. It fits every link.
pub const MAX_PAIR_PAYLOAD: usize = HEADER_LEN + MAX_FEEDBACK + TAG_LEN;

const PAIR_CONTEXT: &[u8] = b"gdp/pair/1";
const SESSION_CONTEXT: &[u8] = b"gdp/pair-session/1";
const VERSION: u8 = 1;
const HEADER_LEN: usize = 1 + 8 + 8;

/// Messages of a session; then the sealer begins another.
const MESSAGES: u64 = 1 << 32;

/// Sessions of the peer whose messages are taken: its own, and what comes late or is repeated of those before its restarts.
const SESSIONS: usize = 4;

/// Sessions that were given up and are not taken again.
const RETIRED: usize = 256;

/// The secret of two entities: clones share nothing, and each is cleared when dropped.
#[derive(Clone)]
pub struct PairKey {
    secret: Zeroizing<[u8; 32]>,
    own: Name,
    peer: Name,
}

/// Why a payload is no feedback of the peer.
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
    /// `HKDF-SHA256(ECDH, info = "gdp/pair/1" ‖ lower name ‖ higher name)`.
    pub fn new(own: (Name, &BoxKey), peer: (Name, &[u8; PUBLIC_KEY_LEN])) -> Result<Self, CryptoError> {
        let (own, own_key) = own;
        let (peer, peer_key) = peer;
        let shared = own_key.agree(peer_key)?;
        let (lower, higher) = (own.min(peer), own.max(peer));
        let info = [PAIR_CONTEXT, lower.as_bytes(), higher.as_bytes()];
        Ok(Self { secret: Backend::default().hkdf_sha256(&[], shared.as_slice(), &info)?, own, peer })
    }

    /// A sealer of what goes to the peer.
    pub fn sealer(&self) -> Result<PairSealer, CryptoError> {
        self.sealer_in(crypto::random()?)
    }

    /// A session that is used twice repeats nonces.
    pub(super) fn sealer_in(&self, session: [u8; 8]) -> Result<PairSealer, CryptoError> {
        let aead = self.session_aead(session, &self.own, &self.peer)?;
        Ok(PairSealer { key: self.clone(), session, aead, next: 1 })
    }

    /// An opener of what comes from the peer.
    pub fn opener(&self) -> PairOpener {
        PairOpener { key: self.clone(), sessions: Vec::new(), retired: VecDeque::new() }
    }

    /// `HKDF-SHA256(pair key, salt = session, info = "gdp/pair-session/1" ‖ sender ‖ receiver)`.
    fn session_aead(&self, session: [u8; 8], sender: &Name, receiver: &Name) -> Result<Aead, CryptoError> {
        let backend = Backend::default();
        let info = [SESSION_CONTEXT, sender.as_bytes(), receiver.as_bytes()];
        backend.aead(&*backend.hkdf_sha256(&session, self.secret.as_slice(), &info)?)
    }
}

/// Seals what one entity tells the other.
pub struct PairSealer {
    key: PairKey,
    session: [u8; 8],
    aead: Aead,
    /// The counter of the next message; they begin at 1.
    next: u64,
}

impl PairSealer {
    /// Puts the payload of a frame to the peer into `out`, whose former content is dropped. After an error `out` is empty.
    pub fn seal(&mut self, feedback: &Feedback, out: &mut Vec<u8>) -> Result<(), PairError> {
        out.clear();
        if self.next > MESSAGES {
            *self = self.key.sealer().map_err(PairError::Crypto)?;
        }
        let header = Header { session: self.session, counter: self.next };
        // Taken before anything is sealed: whatever fails below, no nonce is used again.
        self.next += 1;
        let result = self.seal_behind(header, feedback, out);
        if result.is_err() {
            out.clear();
        }
        result
    }

    fn seal_behind(&self, header: Header, feedback: &Feedback, out: &mut Vec<u8>) -> Result<(), PairError> {
        let clear = header.to_bytes();
        out.extend_from_slice(&clear);
        feedback.encode(out)?;
        let tag = self.aead.seal(&header.nonce(), &clear, &mut out[HEADER_LEN..]).map_err(PairError::Crypto)?;
        out.extend_from_slice(&tag);
        Ok(())
    }
}

/// Opens what the other entity tells this one.
pub struct PairOpener {
    key: PairKey,
    /// The one that was heard last is the last.
    sessions: Vec<Session>,
    retired: VecDeque<[u8; 8]>,
}

struct Session {
    id: [u8; 8],
    aead: Aead,
    window: Window,
}

impl PairOpener {
    /// The feedback in the payload of a frame from the peer.
    pub fn open(&mut self, payload: &[u8]) -> Result<Feedback, PairError> {
        if !(HEADER_LEN + TAG_LEN..=MAX_PAIR_PAYLOAD).contains(&payload.len()) {
            return Err(PairError::Length(payload.len()));
        }
        let length = PairError::Length(payload.len());
        let (clear, sealed) = payload.split_first_chunk().ok_or(length)?;
        let (ciphertext, tag) = sealed.split_last_chunk().ok_or(length)?;
        let header = Header::from_bytes(clear)?;
        let known = self.sessions.iter().position(|session| session.id == header.session);
        let mut session = match known {
            Some(at) => {
                self.sessions[at].window.check(header.counter).map_err(|_| PairError::Replayed)?;
                self.sessions.remove(at)
            }
            None if self.retired.contains(&header.session) => return Err(PairError::Replayed),
            None => Session::new(&self.key, header.session).map_err(PairError::Crypto)?,
        };
        let mut plaintext = vec![0; ciphertext.len()];
        let opened = session.aead.open(&header.nonce(), clear, ciphertext, tag, &mut plaintext);
        if opened.is_ok() {
            session.window.record(header.counter);
        }
        match known {
            // What is forged does not make a session look alive.
            Some(at) if opened.is_err() => self.sessions.insert(at, session),
            None if opened.is_err() => {}
            _ => self.keep(session),
        }
        opened.map_err(|_| PairError::Forged)?;
        Ok(Feedback::decode(&plaintext)?)
    }

    /// As the one heard last, in the place of the one not heard for longest.
    fn keep(&mut self, session: Session) {
        if self.sessions.len() == SESSIONS {
            if self.retired.len() == RETIRED {
                self.retired.pop_front();
            }
            self.retired.push_back(self.sessions.remove(0).id);
        }
        self.sessions.push(session);
    }
}

impl Session {
    fn new(key: &PairKey, id: [u8; 8]) -> Result<Self, CryptoError> {
        Ok(Self { id, aead: key.session_aead(id, &key.peer, &key.own)?, window: Window::new() })
    }
}

#[derive(Clone, Copy)]
struct Header {
    session: [u8; 8],
    counter: u64,
}

impl Header {
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
mod tests {
    use super::*;
    use crate::feedback_wire::{MAX_MISSING, Missing, Wants};
    use crate::identity::{Identity, SigningKey};
    use crate::seal::tests::Random;

    #[test]
    fn two_understand_each_other_and_nobody_else_does() {
        let [a, b, c] = [1, 2, 3].map(identity);
        let (mut to_b, mut from_a) = (pair(&a, &b).sealer().unwrap(), pair(&b, &a).opener());
        for i in 0..100 {
            assert_eq!(from_a.open(&sealed(&mut to_b, i)), Ok(hello(i)));
        }
        let payload = sealed(&mut to_b, 7);
        for (who, mut opener) in [
            ("the sender itself", pair(&a, &b).opener()),
            ("another pair of the receiver", pair(&b, &c).opener()),
            ("a third", pair(&c, &a).opener()),
        ] {
            assert_eq!(opener.open(&payload), Err(PairError::Forged), "{who}");
            assert!(opener.sessions.is_empty());
        }
        // Entities that share a box key are two, and not the same as one with itself.
        let twin = Identity::new(a.key().clone(), "switch");
        assert_eq!(pair(&twin, &b).opener().open(&payload), Err(PairError::Forged));
    }

    #[test]
    fn each_message_is_taken_once_in_any_order() {
        let (mut sealer, mut opener) = channel();
        let mut random = Random(3);
        let mut payloads: Vec<_> = (0..200).map(|i| (i, sealed(&mut sealer, i))).collect();
        random.shuffle(&mut payloads);
        for (i, payload) in &payloads {
            assert_eq!(opener.open(payload), Ok(hello(*i)));
        }
        for (_, payload) in &payloads {
            assert_eq!(opener.open(payload), Err(PairError::Replayed));
        }
        let old = sealed(&mut sealer, 1);
        for i in 0..1024 {
            opener.open(&sealed(&mut sealer, i as u8)).unwrap();
        }
        assert_eq!(opener.open(&old), Err(PairError::Replayed), "too late");
    }

    #[test]
    fn a_restarted_peer_is_understood_and_what_it_said_before_is_not_taken_again() {
        let [a, b] = [1, 2].map(identity);
        let mut opener = pair(&b, &a).opener();
        let mut recorded = Vec::new();
        for _ in 0..SESSIONS + RETIRED {
            let mut sealer = pair(&a, &b).sealer().unwrap();
            for i in 0..2 {
                let payload = sealed(&mut sealer, i);
                assert_eq!(opener.open(&payload), Ok(hello(i)));
                recorded.push(payload);
            }
        }
        for payload in &recorded {
            assert_eq!(opener.open(payload), Err(PairError::Replayed));
        }
        assert_eq!((opener.sessions.len(), opener.retired.len()), (SESSIONS, RETIRED));
    }

    #[test]
    fn memory_is_bounded_and_the_living_session_stays() {
        let [a, b] = [1, 2].map(identity);
        let mut opener = pair(&b, &a).opener();
        let mut living = pair(&a, &b).sealer().unwrap();
        for _ in 0..1000 {
            opener.open(&sealed(&mut living, 1)).unwrap();
            for _ in 0..SESSIONS - 1 {
                opener.open(&sealed(&mut pair(&a, &b).sealer().unwrap(), 2)).unwrap();
            }
            // Forgeries in sessions of their own, and in one that is about to go.
            let mut forged = sealed(&mut pair(&a, &b).sealer().unwrap(), 2);
            forged[HEADER_LEN] ^= 1;
            assert_eq!(opener.open(&forged), Err(PairError::Forged));
        }
        assert_eq!((opener.sessions.len(), opener.retired.len()), (SESSIONS, RETIRED));
    }

    #[test]
    fn hostile_payloads_are_refused_and_change_nothing() {
        let (mut sealer, mut opener) = channel();
        opener.open(&sealed(&mut sealer, 0)).unwrap();
        let payload = sealed(&mut sealer, 1);
        for at in 0..payload.len() {
            let mut changed = payload.clone();
            changed[at] ^= 0x40;
            assert!(opener.open(&changed).is_err(), "byte {at}");
            assert!(opener.open(&payload[..at]).is_err(), "cut to {at}");
        }
        assert_eq!(opener.open(&[VERSION; MAX_PAIR_PAYLOAD + 1]), Err(PairError::Length(MAX_PAIR_PAYLOAD + 1)));
        assert_eq!(opener.open(&[9; 60]), Err(PairError::Version(9)));
        // The number furthest ahead moves no window unless it opens.
        let mut ahead = payload.clone();
        ahead[9..17].fill(0xff);
        assert_eq!(opener.open(&ahead), Err(PairError::Forged));
        assert_eq!(opener.open(&payload), Ok(hello(1)));
    }

    #[test]
    fn a_nonce_is_never_repeated() {
        let (mut sealer, mut opener) = channel();
        let bad = Feedback::Nack { name: name(1), session: [1; 16], missing: vec![] };
        let mut out = vec![1];
        assert_eq!(sealer.seal(&bad, &mut out), Err(PairError::Feedback(FeedbackError::Ranges(0))));
        assert!(out.is_empty());
        let first = sealed(&mut sealer, 1);
        assert_eq!(first[9..17], 2u64.to_be_bytes());
        sealer.next = MESSAGES;
        let (last, next) = (sealed(&mut sealer, 2), sealed(&mut sealer, 3));
        assert_ne!(last[1..9], next[1..9], "another session");
        for (i, payload) in [first, last, next].iter().enumerate() {
            assert_eq!(opener.open(payload), Ok(hello(i as u8 + 1)));
        }
    }

    #[test]
    fn the_largest_feedback_fits_the_smallest_link() {
        let (mut sealer, mut opener) = channel();
        let missing = (1..=MAX_MISSING as u64).map(Missing::whole).collect();
        let nack = Feedback::Nack { name: name(1), session: [1; 16], missing };
        let mut out = Vec::new();
        sealer.seal(&nack, &mut out).unwrap();
        assert_eq!(out.len(), MAX_PAIR_PAYLOAD);
        assert_eq!(opener.open(&out), Ok(nack));
        // QUIC's smallest packet, 1200 bytes, less the header of a frame.
        const { assert!(MAX_PAIR_PAYLOAD <= 1200 - 96) };
    }

    #[test]
    fn nothing_prints_a_key() {
        let [a, b] = [1, 2].map(identity);
        let key = pair(&a, &b);
        let text = format!("{key:?} {:?} {:?}", key.sealer().unwrap(), key.opener());
        assert!(!text.contains(&hex::encode(&key.secret[..4])), "{text}");
        assert!(!text.contains(&format!("{}, {}, {}", key.secret[0], key.secret[1], key.secret[2])), "{text}");
    }

    fn channel() -> (PairSealer, PairOpener) {
        let [a, b] = [1, 2].map(identity);
        (pair(&a, &b).sealer().unwrap(), pair(&b, &a).opener())
    }

    fn pair(own: &Identity, peer: &Identity) -> PairKey {
        PairKey::new((own.name(), own.box_key()), (peer.name(), &peer.box_public())).unwrap()
    }

    fn sealed(sealer: &mut PairSealer, i: u8) -> Vec<u8> {
        let mut out = Vec::new();
        sealer.seal(&hello(i), &mut out).unwrap();
        out
    }

    fn hello(i: u8) -> Feedback {
        Feedback::Hello { name: name(1), challenge: [i; 16], wants: Wants::Newest }
    }

    fn identity(seed: u8) -> Identity {
        Identity::new(SigningKey::for_test(seed), "proxy")
    }

    fn name(i: u8) -> Name {
        Name::from_bytes([i; 32])
    }
}
