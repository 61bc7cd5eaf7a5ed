//! The reader's state of one writer of a name: keys, sessions and incomplete messages. This module
//! makes all decisions about a segment; [`super::Reader`] finds the writer and counts.

use super::DropReason;
use super::assembly::Assembly;
use super::heartbeat::HeartbeatBody;
use super::merkle::SignedTree;
use super::segment::Segment;
use super::session::{SegmentPosition, Session};
use super::signed_parts::{SignedParts, check_age, unsigned};
use super::wire::{Kind, Proof, SegmentHeader};
use crate::seal::event::{Heartbeat, Lost, Push, ReaderContext};
use gdp_core::crypto::{self, Verifier};
use gdp_core::keys::EpochKey;
use gdp_core::name::Name;
use std::borrow::Cow;

/// Maximum number of incomplete messages of one session. Beyond it, the oldest is given up.
const MAX_IN_FLIGHT: usize = 256;

/// Number of epochs of one writer with retained keys: the current one, the previous one, and a
/// reserve for quick successions.
pub const MAX_EPOCHS: usize = 4;

pub struct WriterState {
    pub(super) name: Name,
    pub(super) verifier: Verifier,
    keys: Vec<(u32, EpochKey)>,
    pub(super) sessions: Vec<Session>,
    /// Bytes charged to its assemblies.
    memory: usize,
    /// The last verified tree, so that the signature of a batch is verified only once.
    pub(super) signed: SignedTree,
    /// Counts deliveries, to order the sessions by last use.
    clock: u64,
}

impl WriterState {
    pub fn new(name: Name, verifier: Verifier) -> Self {
        let (keys, sessions) = (Vec::new(), Vec::new());
        Self { name, verifier, keys, sessions, memory: 0, signed: SignedTree::default(), clock: 0 }
    }

    pub fn memory(&self) -> usize {
        self.memory
    }

    pub fn set_key(&mut self, epoch: u32, key: EpochKey) {
        self.drop_key(epoch);
        self.keys.push((epoch, key));
        if self.keys.len() > MAX_EPOCHS
            && let Some(lowest) = self.keys.iter().map(|(epoch, _)| *epoch).min()
        {
            self.drop_key(lowest);
        }
    }

    pub fn drop_key(&mut self, epoch: u32) {
        self.keys.retain(|(of, _)| *of != epoch);
        self.sessions.iter_mut().for_each(|session| session.keys.forget(epoch));
    }

    /// Confirms a session. If too many sessions are confirmed, discards the least recently used
    /// one.
    pub fn confirm_session(&mut self, shared: &mut ReaderContext, id: [u8; 16], from: u64) {
        self.clock += 1;
        let at = self.position(&id).unwrap_or_else(|| {
            self.sessions.push(Session::new(id));
            self.sessions.len() - 1
        });
        let session = &mut self.sessions[at];
        session.from = Some(session.from.map_or(from, |earlier| earlier.min(from)));
        session.last_used = self.clock;
        let vouched = self.sessions.iter().enumerate().filter(|(_, session)| session.from.is_some());
        if vouched.clone().count() > shared.limits.max_sessions.max(1)
            && let Some((unused, _)) = vouched.min_by_key(|(_, session)| session.last_used)
        {
            self.forget(shared, unused);
        }
    }

    /// Gives up messages whose deadline is before `steady_ns`, and updates the next deadline.
    pub fn expire(&mut self, shared: &mut ReaderContext, steady_ns: u64) -> usize {
        let (mut expired, mut freed) = (0, 0);
        for session in &mut self.sessions {
            session.assemblies.retain(|_, assembly| {
                let keep = assembly.deadline >= steady_ns;
                if keep {
                    shared.next_deadline = shared.next_deadline.min(assembly.deadline);
                } else {
                    expired += 1;
                    freed += assembly.cost;
                }
                keep
            });
        }
        self.free(shared, freed);
        expired
    }

    /// Processes one segment, from its header to delivery.
    pub fn take(&mut self, push: &mut Push<'_>, segment: &Segment<'_>) -> Result<(), DropReason> {
        let scratch = std::mem::take(&mut push.scratch);
        let result = self.segment(push, &mut scratch[..segment.plaintext_len], segment);
        push.scratch = scratch;
        result
    }

    fn segment(&mut self, push: &mut Push<'_>, scratch: &mut [u8], segment: &Segment<'_>) -> Result<(), DropReason> {
        let header = &segment.header;
        let limits = &push.shared.limits;
        let cost = match header.kind {
            Kind::Body | Kind::Last => Assembly::cost(header, limits.max_message)?,
            Kind::Heartbeat | Kind::Bundle => 0,
        };
        if cost > limits.max_memory_per_source.min(limits.max_memory) {
            return Err(DropReason::TooLarge);
        }
        let place = (header.sequence, header.cut);
        let (_, key) = self.keys.iter().find(|(epoch, _)| *epoch == header.epoch).ok_or(DropReason::NoKey)?;
        let derive = || key.session_key(push.shared.backend, &push.shared.name, &self.name, &header.session);
        let (at, commitment) = match self.position(&header.session) {
            Some(at) => {
                let session = &mut self.sessions[at];
                let key = session.keys.of(header.epoch, derive)?;
                if let Some(assembly) = session.assemblies.get_mut(&place)
                    && header.kind == Kind::Body
                    && assembly.fits(header)
                    && !assembly.has(header)
                {
                    // The common case of a large message: opened directly in its slot, without a
                    // copy.
                    let slot = assembly.slot(header, segment.plaintext_len);
                    segment.open(&key.aead, slot)?;
                    let digest = crypto::sha256(&[&*slot]);
                    assembly.mark(header, segment.plaintext_len, digest);
                    push.out.segments.push(segment.id());
                    return self.deliver_if_complete(push, at, header);
                }
                segment.open(&key.aead, scratch)?;
                (at, key.commitment)
            }
            None => {
                let key = derive().map_err(|_| DropReason::Internal)?;
                segment.open(&key.aead, scratch)?;
                let commitment = key.commitment;
                let mut session = Session::new(header.session);
                session.keys.of(header.epoch, || Ok(key))?;
                (self.admit(push.shared, session), commitment)
            }
        };

        let last = header.sequence + u64::from(header.messages().saturating_sub(1));
        if last < self.sessions[at].from.ok_or(DropReason::Unvouched)? {
            return Err(DropReason::Stale);
        }
        if header.kind == Kind::Heartbeat {
            return self.heartbeat(push, at, header, scratch);
        }
        self.check_wanted(push, at, header)?;
        let (part, proof) = match header.kind {
            Kind::Last | Kind::Bundle => {
                let (part, proof) = Proof::split(scratch).ok_or(DropReason::BadMessage)?;
                (part, Some(proof))
            }
            Kind::Body | Kind::Heartbeat => (&*scratch, None),
        };
        if part.len() > header.size as usize || header.is_whole() && part.len() != header.size as usize {
            return Err(DropReason::BadMessage);
        }
        let digest = crypto::sha256(&[part]);
        if let Some(proof) = proof.filter(|_| header.is_whole()) {
            // The common case of small messages uses no memory before verification.
            push.out.segments.push(segment.id());
            let signed = SignedParts { commitment, digests: &[digest], proof };
            return self.deliver(push, at, header, Cow::Borrowed(part), signed);
        }
        match self.sessions[at].assemblies.get(&place) {
            Some(assembly) if !assembly.fits(header) => return Err(DropReason::Inconsistent),
            Some(assembly) if assembly.has(header) => return Err(DropReason::Duplicate),
            Some(_) => {}
            None => {
                self.make_room(push, at, place, cost)?;
                self.begin_assembly(push, at, header, commitment, cost);
            }
        }
        let assembly = self.sessions[at].assemblies.get_mut(&place).ok_or(DropReason::Internal)?;
        assembly.slot(header, part.len()).copy_from_slice(part);
        assembly.mark(header, part.len(), digest);
        if proof.is_some() {
            assembly.set_proof(&scratch[part.len()..]);
        }
        push.out.segments.push(segment.id());
        self.deliver_if_complete(push, at, header)
    }

    /// Checks that a message of the segment may still be delivered.
    fn check_wanted(&mut self, push: &mut Push<'_>, at: usize, header: &SegmentHeader) -> Result<(), DropReason> {
        let session = &mut self.sessions[at];
        let from = session.from.unwrap_or(0);
        let wanted = (header.sequence..).take(header.messages() as usize).filter(|sequence| *sequence >= from);
        let checked = wanted.map(|sequence| session.window.check(sequence)).reduce(Result::or);
        let result = checked.unwrap_or(Err(DropReason::Stale));
        if result.is_err() {
            // The window has moved past an incomplete message, which can no longer be delivered.
            let freed = session.give_up(header.sequence);
            self.free(push.shared, freed);
        }
        result
    }

    fn position(&self, id: &[u8; 16]) -> Option<usize> {
        self.sessions.iter().position(|session| session.id == *id)
    }

    /// Adds a session with one authentic segment, so that its key is not derived again. If too many
    /// sessions are unconfirmed, discards the oldest of them.
    fn admit(&mut self, shared: &mut ReaderContext, session: Session) -> usize {
        let waiting = self.sessions.iter().filter(|session| session.from.is_none()).count();
        if waiting >= shared.limits.max_sessions.max(1)
            && let Some(oldest) = self.sessions.iter().position(|session| session.from.is_none())
        {
            self.forget(shared, oldest);
        }
        self.sessions.push(session);
        self.sessions.len() - 1
    }

    fn heartbeat(
        &mut self,
        push: &mut Push<'_>,
        at: usize,
        header: &SegmentHeader,
        plaintext: &[u8],
    ) -> Result<(), DropReason> {
        let session = &mut self.sessions[at];
        // An overtaken heartbeat contains nothing new.
        if header.index <= session.heartbeat {
            return Err(DropReason::Duplicate);
        }
        let (body, signature) = HeartbeatBody::parse(plaintext).ok_or(DropReason::BadMessage)?;
        let statement = body.statement(&push.shared.name, &self.name, header);
        self.verifier.verify(&statement, signature).map_err(unsigned)?;
        check_age(push, body.timestamp_ns)?;
        session.heartbeat = header.index;
        push.out.heartbeats.push(Heartbeat {
            session: header.session,
            next: header.sequence,
            oldest: body.oldest,
            timestamp_ns: body.timestamp_ns,
        });
        Ok(())
    }

    fn begin_assembly(
        &mut self,
        push: &mut Push<'_>,
        at: usize,
        header: &SegmentHeader,
        commitment: [u8; 32],
        cost: usize,
    ) {
        let shared = &mut *push.shared;
        let timeout = u64::try_from(shared.limits.deadline.as_nanos()).unwrap_or(u64::MAX);
        let deadline = push.now.steady_ns.saturating_add(timeout);
        let place = (header.sequence, header.cut);
        self.sessions[at].assemblies.insert(place, Assembly::new(header, commitment, deadline, cost));
        self.memory += cost;
        shared.memory += cost;
        shared.next_deadline = shared.next_deadline.min(deadline);
    }

    /// Gives up this writer's oldest incomplete messages until `cost` more bytes are within the
    /// limits. Never gives up a message of another writer, or a newer one of the same session.
    fn make_room(
        &mut self,
        push: &mut Push<'_>,
        at: usize,
        place: SegmentPosition,
        cost: usize,
    ) -> Result<(), DropReason> {
        let shared = &mut *push.shared;
        loop {
            let crowded = self.sessions[at].assemblies.len() >= MAX_IN_FLIGHT;
            let full = self.memory + cost > shared.limits.max_memory_per_source
                || shared.memory + cost > shared.limits.max_memory;
            let oldest = if crowded {
                self.sessions[at].assemblies.keys().next().map(|&oldest| (at, oldest))
            } else if full {
                self.oldest_assembly()
            } else {
                return Ok(());
            };
            match oldest {
                Some((session, oldest)) if session != at || oldest < place => {
                    let freed = self.sessions[session].assemblies.remove(&oldest).map_or(0, |assembly| assembly.cost);
                    self.free(shared, freed);
                    shared.count(DropReason::Evicted, 1);
                    push.out.lost.push(Lost { session: self.sessions[session].id, sequence: oldest.0, again: true });
                }
                _ => return Err(DropReason::MemoryFull),
            }
        }
    }

    fn oldest_assembly(&self) -> Option<(usize, SegmentPosition)> {
        let all = self.sessions.iter().enumerate().flat_map(|(at, session)| {
            session.assemblies.iter().map(move |(&place, assembly)| (assembly.deadline, at, place))
        });
        all.min().map(|(_, at, place)| (at, place))
    }

    /// Marks a verified message as delivered. Its other cuts are no longer needed.
    pub(super) fn accept(&mut self, shared: &mut ReaderContext, at: usize, sequence: u64) -> Result<(), DropReason> {
        self.clock += 1;
        let session = &mut self.sessions[at];
        session.window.check(sequence)?;
        session.window.record(sequence);
        session.last_used = self.clock;
        let freed = session.give_up(sequence);
        self.free(shared, freed);
        Ok(())
    }

    fn forget(&mut self, shared: &mut ReaderContext, at: usize) {
        let session = self.sessions.remove(at);
        self.free(shared, session.assemblies.values().map(|assembly| assembly.cost).sum());
        shared.count(DropReason::Evicted, session.assemblies.len() as u64);
    }

    pub(super) fn free(&mut self, shared: &mut ReaderContext, bytes: usize) {
        self.memory -= bytes;
        shared.memory -= bytes;
    }
}
