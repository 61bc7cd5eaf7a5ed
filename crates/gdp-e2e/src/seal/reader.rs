//! The reader: frame payloads in, verified messages out. The order of checks is essential: bounds,
//! known writer and key, GCM, confirmed session, replay window, memory. The signature is checked
//! when the message is complete. A forged segment is refused before it uses memory.
//!
//! Readers of a name share the epoch keys, so the damage that they can do to each other is also
//! limited. Only a verified signature advances a replay window. Only a confirmation of the writer
//! lets a session replace another.

use super::DropReason;
use super::segment::Segment;
use super::source::WriterState;
use super::wire;
pub use crate::seal::event::{Push, Timestamps};
use crate::seal::event::{ReaderContext, ReaderLimits, Received};
use gdp_core::crypto::{Backend, CryptoError};
use gdp_core::identity::VerifyKey;
use gdp_core::keys::EpochKey;
use gdp_core::name::Name;
use std::collections::HashMap;
use std::fmt;

/// Reads one name, from the authorised writers.
pub struct Reader {
    sources: HashMap<Name, WriterState>,
    shared: ReaderContext,
    /// Buffer for opening segments without a slot.
    scratch: Box<[u8]>,
}

impl Reader {
    pub fn new(name: Name, backend: Backend, limits: ReaderLimits) -> Self {
        let shared =
            ReaderContext { name, backend, limits, memory: 0, drops: [0; DropReason::COUNT], next_deadline: u64::MAX };
        Self { sources: HashMap::new(), shared, scratch: vec![0; wire::MAX_PLAINTEXT].into() }
    }

    /// Authorises `writer`, whose messages are signed by `key`. Messages are delivered once their
    /// keys are set and the writer has confirmed its session. The caller must have verified that
    /// the writer may write.
    pub fn authorise(&mut self, writer: Name, key: VerifyKey) -> Result<(), CryptoError> {
        if !self.sources.contains_key(&writer) {
            self.sources.insert(writer, WriterState::new(writer, key.verifier(self.shared.backend)?));
        }
        Ok(())
    }

    /// Stops delivery from `writer`, and discards its keys and incomplete messages.
    pub fn revoke(&mut self, writer: &Name) {
        if let Some(source) = self.sources.remove(writer) {
            self.shared.memory -= source.memory();
        }
    }

    /// Sets the key of an authorised writer for an epoch. With more than four epochs, drops the
    /// lowest.
    pub fn set_key(&mut self, writer: &Name, epoch: u32, key: EpochKey) -> Result<(), DropReason> {
        self.source(writer).map(|source| source.set_key(epoch, key))
    }

    /// Drops the key of an epoch, so that its segments no longer open. Messages with opened
    /// segments may still become complete.
    pub fn drop_key(&mut self, writer: &Name, epoch: u32) {
        if let Some(source) = self.sources.get_mut(writer) {
            source.drop_key(epoch);
        }
    }

    /// Records the writer's answer to a recent challenge: it runs this session, and messages from
    /// this sequence on are current. Other sessions and earlier messages may be recordings.
    /// Repeated calls can only lower the sequence.
    pub fn confirm_session(&mut self, writer: &Name, session: [u8; 16], from_sequence: u64) -> Result<(), DropReason> {
        let source = self.sources.get_mut(writer).ok_or(DropReason::UnknownWriter)?;
        source.confirm_session(&mut self.shared, session, from_sequence);
        Ok(())
    }

    pub fn writers(&self) -> impl Iterator<Item = &Name> {
        self.sources.keys()
    }

    /// Processes the payload of a frame from `source` and appends the results to `out`. Counts each
    /// dropped segment and returns the first drop reason. Other segments of the payload are still
    /// used.
    pub fn push(
        &mut self,
        now: Timestamps,
        source: Name,
        payload: &[u8],
        out: &mut Received,
    ) -> Result<(), DropReason> {
        if self.shared.next_deadline < now.steady_ns {
            self.expire(now.steady_ns);
        }
        let Self { sources, shared, scratch } = self;
        let mut source = sources.get_mut(&source);
        let mut push = Push { shared, scratch, now, out };
        let mut result = Ok(());
        let mut rest = payload;
        loop {
            let (taken, behind) = match Segment::split(rest) {
                Ok((segment, behind)) => {
                    let taken = match source.as_deref_mut() {
                        Some(source) => source.take(&mut push, &segment),
                        None => Err(DropReason::UnknownWriter),
                    };
                    if taken == Err(DropReason::Duplicate) {
                        push.out.repeated.push(segment.id());
                    }
                    (taken, behind)
                }
                Err(reason) => (Err(reason), &[][..]),
            };
            if let Err(reason) = taken {
                push.shared.count(reason, 1);
            }
            result = result.and(taken);
            rest = behind;
            if rest.is_empty() {
                return result;
            }
        }
    }

    /// Gives up the messages whose deadline is before `steady_ns`, and returns their number.
    /// [`Self::push`] calls this itself; without traffic, the caller must call it.
    pub fn expire(&mut self, steady_ns: u64) -> usize {
        self.shared.next_deadline = u64::MAX;
        let expired = self.sources.values_mut().map(|source| source.expire(&mut self.shared, steady_ns)).sum();
        self.shared.count(DropReason::Deadline, expired as u64);
        expired
    }

    /// Returns the time when [`Self::expire`] may have work, or `None` while no message is
    /// incomplete.
    pub fn next_deadline(&self) -> Option<u64> {
        (self.shared.memory > 0).then_some(self.shared.next_deadline)
    }

    /// Returns the number of dropped segments and messages, indexed by [`DropReason`] (`as usize`),
    /// in the order of [`DropReason::ALL`].
    pub fn drops(&self) -> &[u64; DropReason::COUNT] {
        &self.shared.drops
    }

    /// Returns the bytes charged to incomplete messages.
    pub fn memory(&self) -> usize {
        self.shared.memory
    }

    fn source(&mut self, writer: &Name) -> Result<&mut WriterState, DropReason> {
        self.sources.get_mut(writer).ok_or(DropReason::UnknownWriter)
    }
}

impl fmt::Debug for Reader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ReaderContext { name, memory, .. } = &self.shared;
        write!(f, "Reader {{ name: {name:#}, writers: {}, memory: {memory} }}", self.sources.len())
    }
}
