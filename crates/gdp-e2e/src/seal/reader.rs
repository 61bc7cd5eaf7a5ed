//! The reading end: frame payloads in, verified messages out. The order of checks is the point:
//! bounds, known writer and key, GCM, whether the writer vouched for the session, replay window,
//! memory, and when all is there the signature. A forged segment is refused before it costs memory.
//!
//! What readers of a name can do to each other (they share the epoch keys) is limited too: only a
//! verified signature moves a replay window, and only the writer's word lets a session displace
//! another.

use super::DropReason;
use super::segment::Segment;
use super::source::WriterState;
use super::wire::{self, Kind};
pub use crate::seal::event::{Push, Timestamps};
use crate::seal::event::{ReaderContext, ReaderLimits, Received};
use gdp_core::crypto::{Backend, CryptoError};
use gdp_core::identity::VerifyKey;
use gdp_core::keys::EpochKey;
use gdp_core::name::Name;
use std::collections::HashMap;
use std::fmt;

/// Reads one name, from the writers it was told of.
pub struct Reader {
    sources: HashMap<Name, WriterState>,
    shared: ReaderContext,
    /// Where segments are opened that have no place yet: a body, and behind it a proof.
    scratch: Box<[u8]>,
}

const SCRATCH_LEN: usize = wire::MAX_PLAINTEXT + wire::proof_len(wire::MAX_DEPTH);

impl Reader {
    pub fn new(name: Name, backend: Backend, limits: ReaderLimits) -> Self {
        let shared =
            ReaderContext { name, backend, limits, memory: 0, drops: [0; DropReason::COUNT], next_deadline: u64::MAX };
        Self { sources: HashMap::new(), shared, scratch: vec![0; SCRATCH_LEN].into() }
    }

    /// From now on messages of `writer`, signed by `key`, are delivered, once there are the keys to
    /// open them and the writer has vouched for its session. The caller has verified that it may
    /// write.
    pub fn authorise(&mut self, writer: Name, key: VerifyKey) -> Result<(), CryptoError> {
        if !self.sources.contains_key(&writer) {
            self.sources.insert(writer, WriterState::new(writer, key.verifier(self.shared.backend)?));
        }
        Ok(())
    }

    /// Nothing of `writer` is delivered any more; its keys and what was incomplete are forgotten.
    pub fn revoke(&mut self, writer: &Name) {
        if let Some(source) = self.sources.remove(writer) {
            self.shared.memory -= source.memory();
        }
    }

    /// What an authorised writer seals with in an epoch. Of more than four epochs the lowest goes.
    pub fn set_key(&mut self, writer: &Name, epoch: u32, key: EpochKey) -> Result<(), DropReason> {
        self.source(writer).map(|source| source.set_key(epoch, key))
    }

    /// Nothing that the writer sealed in this epoch opens any more. What opened before may still
    /// become complete.
    pub fn drop_key(&mut self, writer: &Name, epoch: u32) {
        if let Some(source) = self.sources.get_mut(writer) {
            source.drop_key(epoch);
        }
    }

    /// The writer, asked just now, says that it runs this session and that messages from this
    /// sequence on are to be read: those of other sessions, and those before it, may be recordings.
    /// Said again, it can only go back.
    pub fn confirm_session(&mut self, writer: &Name, session: [u8; 16], from_sequence: u64) -> Result<(), DropReason> {
        let source = self.sources.get_mut(writer).ok_or(DropReason::UnknownWriter)?;
        source.confirm_session(&mut self.shared, session, from_sequence);
        Ok(())
    }

    pub fn writers(&self) -> impl Iterator<Item = &Name> {
        self.sources.keys()
    }

    /// Takes the payload of a frame whose source is `source`, and appends what it brings to `out`.
    /// If segments of it are dropped, the first reason is returned, and each is counted; other
    /// segments of the payload are used all the same.
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
                    let (taken, behind) = take(source.as_deref_mut(), &mut push, &segment, behind);
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

    /// Gives up the messages whose deadline is before `steady_ns`; returns how many. [`Self::push`]
    /// does so by itself; without traffic somebody has to.
    pub fn expire(&mut self, steady_ns: u64) -> usize {
        self.shared.next_deadline = u64::MAX;
        let expired = self.sources.values_mut().map(|source| source.expire(&mut self.shared, steady_ns)).sum();
        self.shared.count(DropReason::Deadline, expired as u64);
        expired
    }

    /// When [`Self::expire`] may have something to do; `None` while nothing is incomplete.
    pub fn next_deadline(&self) -> Option<u64> {
        (self.shared.memory > 0).then_some(self.shared.next_deadline)
    }

    /// Segments and messages dropped so far, indexed by [`DropReason`] (`as usize`), in the order
    /// of [`DropReason::ALL`].
    pub fn drops(&self) -> &[u64; DropReason::COUNT] {
        &self.shared.drops
    }

    /// Bytes charged to incomplete messages.
    pub fn memory(&self) -> usize {
        self.shared.memory
    }

    fn source(&mut self, writer: &Name) -> Result<&mut WriterState, DropReason> {
        self.sources.get_mut(writer).ok_or(DropReason::UnknownWriter)
    }
}

/// One segment, with its proof if that is all there is beside it; returns what is behind as well.
fn take<'p>(
    source: Option<&mut WriterState>,
    push: &mut Push<'_>,
    segment: &Segment<'_>,
    behind: &'p [u8],
) -> (Result<(), DropReason>, &'p [u8]) {
    let Some(source) = source else { return (Err(DropReason::UnknownWriter), behind) };
    let header = &segment.header;
    if header.kind == Kind::Body
        && header.count == 1
        && let Ok((proof, behind_proof)) = Segment::split(behind)
        && proof.proves(header)
        && let Some(result) = source.take_whole(push, segment, &proof)
    {
        return (result, behind_proof);
    }
    (source.take(push, segment), behind)
}

impl fmt::Debug for Reader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ReaderContext { name, memory, .. } = &self.shared;
        write!(f, "Reader {{ name: {name:#}, writers: {}, memory: {memory} }}", self.sources.len())
    }
}
