//! The reading end: frame payloads in, verified messages out. The order of checks is the point: bounds, known writer,
//! GCM, replay window, memory, and when all is there the signature. A forged segment is refused before it costs memory.
//!
//! What readers of a name can do to each other (they share the epoch key) is limited too: only a verified signature
//! moves a replay window or lets a session displace another.

use super::assembly::Assembly;
use super::window::Window;
use super::wire::{self, Encoding, HEADER_LEN, MessageHeader, Proof, SegmentHeader};
use super::{DropReason, EpochKey, merkle};
use crate::crypto::{Aead, Backend, CryptoError, TAG_LEN, Verifier};
use crate::identity::VerifyKey;
use crate::name::Name;
use bytes::Bytes;
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::time::Duration;

/// Incomplete messages of one session; when there are more, the oldest is given up.
const MAX_IN_FLIGHT: usize = 256;

/// How much a reader lets its writers use.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Bytes of a message body.
    pub max_message: usize,
    /// Bytes of incomplete messages of one writer, bookkeeping included.
    pub max_memory_per_source: usize,
    /// Bytes of incomplete messages of all writers.
    pub max_memory: usize,
    /// How long after its first segment a message must be complete.
    pub deadline: Duration,
    /// Sessions per writer whose replay windows are kept, and as many again that have not shown a signature yet.
    pub max_sessions: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_message: 64 << 20,
            max_memory_per_source: 128 << 20,
            max_memory: 512 << 20,
            deadline: Duration::from_secs(1),
            max_sessions: 8,
        }
    }
}

/// A message as its writer signed it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    pub name: Name,
    pub writer: Name,
    pub session: [u8; 16],
    pub sequence: u64,
    /// Unix time on the writer's clock.
    pub timestamp_ns: u64,
    pub encoding: Encoding,
    pub body: Bytes,
}

/// Reads one name, from the writers it was told of.
pub struct Reader {
    name: Name,
    epoch_key: EpochKey,
    backend: Backend,
    limits: Limits,
    writers: HashMap<Name, WriterState>,
    /// Bytes charged to all assemblies.
    memory: usize,
    /// Where a segment is opened that has no place yet.
    scratch: Box<[u8]>,
    drops: [u64; DropReason::COUNT],
    /// No assembly's deadline is before this.
    next_deadline: u64,
}

struct WriterState {
    verifier: Verifier,
    sessions: Vec<Session>,
    memory: usize,
    /// New sessions must show messages signed later than this (Unix ns): the windows of forgotten sessions are gone.
    floor: u64,
    /// A batch is verified once: that the writer signed this root stays true.
    verified_root: Option<[u8; 32]>,
    /// Counts deliveries; orders the sessions by last use.
    clock: u64,
}

struct Session {
    id: [u8; 16],
    aead: Aead,
    window: Window,
    assemblies: BTreeMap<u64, Assembly>,
    /// Whether a message of it was ever verified.
    proven: bool,
    floor: u64,
    newest_timestamp: u64,
    last_used: u64,
}

impl Reader {
    pub fn new(name: Name, epoch_key: &EpochKey, backend: Backend, limits: Limits) -> Self {
        Self {
            name,
            epoch_key: epoch_key.clone(),
            backend,
            limits,
            writers: HashMap::new(),
            memory: 0,
            scratch: vec![0; wire::MAX_PLAINTEXT].into(),
            drops: [0; DropReason::COUNT],
            next_deadline: u64::MAX,
        }
    }

    /// From now on messages of `writer`, signed by `key`, are delivered. The caller has verified that it may write.
    pub fn authorise(&mut self, writer: Name, key: VerifyKey) -> Result<(), CryptoError> {
        if self.writers.contains_key(&writer) {
            return Ok(());
        }
        let verifier = key.verifier(self.backend)?;
        let state = WriterState { verifier, sessions: vec![], memory: 0, floor: 0, verified_root: None, clock: 0 };
        self.writers.insert(writer, state);
        Ok(())
    }

    /// Nothing of `writer` is delivered any more; what was incomplete is forgotten.
    pub fn revoke(&mut self, writer: &Name) {
        if let Some(state) = self.writers.remove(writer) {
            self.memory -= state.memory;
        }
    }

    pub fn writers(&self) -> impl Iterator<Item = &Name> {
        self.writers.keys()
    }

    /// Refuses what `writer` signed at or before `timestamp_ns` (Unix). A reader that just started knows no replay
    /// windows; with this, recordings from before its start are of no use against it.
    pub fn refuse_before(&mut self, writer: &Name, timestamp_ns: u64) {
        if let Some(state) = self.writers.get_mut(writer) {
            state.floor = state.floor.max(timestamp_ns);
            state.sessions.iter_mut().for_each(|session| session.floor = session.floor.max(timestamp_ns));
        }
    }

    /// Takes the payload of a frame whose source is `source`, at `now` (ns of any clock that never goes back), and
    /// appends the messages that it completes. If segments of it are dropped, the first reason is returned, and each is
    /// counted; other segments of the payload are used all the same.
    pub fn push(&mut self, now: u64, source: Name, payload: &[u8], out: &mut Vec<Message>) -> Result<(), DropReason> {
        if self.next_deadline < now {
            self.expire(now);
        }
        let mut result = if payload.is_empty() { self.count(Err(DropReason::Truncated)) } else { Ok(()) };
        let mut rest = payload;
        while !rest.is_empty() {
            let taken = match split_segment(rest) {
                Ok((segment, behind)) => {
                    rest = behind;
                    self.segment(now, source, &segment, out)
                }
                Err(reason) => {
                    rest = &[];
                    Err(reason)
                }
            };
            result = result.and(self.count(taken));
        }
        result
    }

    /// Gives up the messages whose deadline is before `now`; returns how many. [`Self::push`] does so by itself; without
    /// traffic somebody has to.
    pub fn expire(&mut self, now: u64) -> usize {
        let (mut expired, mut next) = (0, u64::MAX);
        for writer in self.writers.values_mut() {
            for session in &mut writer.sessions {
                session.assemblies.retain(|_, assembly| {
                    let keep = assembly.deadline >= now;
                    if keep {
                        next = next.min(assembly.deadline);
                    } else {
                        expired += 1;
                        writer.memory -= assembly.cost;
                        self.memory -= assembly.cost;
                    }
                    keep
                });
            }
        }
        self.next_deadline = next;
        self.drops[DropReason::Deadline as usize] += expired as u64;
        expired
    }

    /// When [`Self::expire`] may have something to do; `None` while nothing is incomplete.
    pub fn next_deadline(&self) -> Option<u64> {
        (self.memory > 0).then_some(self.next_deadline)
    }

    /// Segments and messages dropped so far, indexed by [`DropReason`] (`as usize`), in the order of [`DropReason::ALL`].
    pub fn drops(&self) -> &[u64; DropReason::COUNT] {
        &self.drops
    }

    /// Bytes charged to incomplete messages.
    pub fn memory(&self) -> usize {
        self.memory
    }

    fn count(&mut self, result: Result<(), DropReason>) -> Result<(), DropReason> {
        result.inspect_err(|reason| self.drops[*reason as usize] += 1)
    }

    /// One segment, from header to delivery.
    fn segment(
        &mut self,
        now: u64,
        source: Name,
        segment: &Segment<'_>,
        out: &mut Vec<Message>,
    ) -> Result<(), DropReason> {
        let header = &segment.header;
        let cost = Assembly::cost(header, self.limits.max_message)?;
        if cost > self.limits.max_memory_per_source.min(self.limits.max_memory) {
            return Err(DropReason::TooLarge);
        }
        let writer = self.writers.get_mut(&source).ok_or(DropReason::UnknownWriter)?;

        let known = writer.sessions.iter().position(|session| session.id == header.session);
        let at = match known {
            Some(at) => {
                let session = &mut writer.sessions[at];
                if let Some(assembly) = session.assemblies.get_mut(&header.sequence)
                    && assembly.fits(header)
                    && !assembly.has(header)
                    && !header.proof
                {
                    // The common case of a large message: opened in its place, without a copy.
                    segment.open(&session.aead, assembly.slot(header, segment.plaintext_len))?;
                    assembly.mark(header, segment.plaintext_len, segment.digest(self.backend));
                    return self.deliver_if_complete(source, at, header, out);
                }
                segment.open(&session.aead, &mut self.scratch[..segment.plaintext_len])?;
                at
            }
            None => {
                let aead = self
                    .epoch_key
                    .session_aead(self.backend, &self.name, &source, &header.session)
                    .map_err(|_| DropReason::Internal)?;
                segment.open(&aead, &mut self.scratch[..segment.plaintext_len])?;
                let (at, freed, given_up) = writer.admit(header.session, aead, self.limits.max_sessions);
                self.memory -= freed;
                self.drops[DropReason::Evicted as usize] += given_up;
                at
            }
        };

        if let Err(reason) = writer.sessions[at].window.check(header.sequence) {
            // The window has moved past a message that was still incomplete: it cannot be delivered any more.
            self.memory -= writer.give_up(at, header.sequence);
            return Err(reason);
        }
        match writer.sessions[at].assemblies.get(&header.sequence) {
            Some(assembly) if !assembly.fits(header) => return Err(DropReason::Inconsistent),
            Some(assembly) if assembly.has(header) => return Err(DropReason::Duplicate),
            Some(_) => {}
            None => {
                self.make_room(&source, at, header.sequence, cost)?;
                self.begin_assembly(now, &source, at, header, cost);
            }
        }
        let session = self.writers.get_mut(&source).and_then(|writer| writer.sessions.get_mut(at));
        let assembly = session.and_then(|session| session.assemblies.get_mut(&header.sequence));
        let assembly = assembly.ok_or(DropReason::Internal)?;
        let plaintext = &self.scratch[..segment.plaintext_len];
        if header.proof {
            assembly.set_proof(plaintext);
        } else {
            assembly.slot(header, plaintext.len()).copy_from_slice(plaintext);
            assembly.mark(header, plaintext.len(), segment.digest(self.backend));
        }
        self.deliver_if_complete(source, at, header, out)
    }

    fn begin_assembly(&mut self, now: u64, source: &Name, at: usize, header: &SegmentHeader, cost: usize) {
        let Some(writer) = self.writers.get_mut(source) else { return };
        let deadline = now.saturating_add(u64::try_from(self.limits.deadline.as_nanos()).unwrap_or(u64::MAX));
        writer.sessions[at].assemblies.insert(header.sequence, Assembly::new(header, deadline, cost));
        writer.memory += cost;
        self.memory += cost;
        self.next_deadline = self.next_deadline.min(deadline);
    }

    /// Gives up the writer's own oldest incomplete messages until `cost` more bytes are within the limits. Never one of
    /// another writer, and never a newer one of the same session.
    fn make_room(&mut self, source: &Name, at: usize, sequence: u64, cost: usize) -> Result<(), DropReason> {
        let Some(writer) = self.writers.get_mut(source) else { return Err(DropReason::Internal) };
        loop {
            let crowded = writer.sessions[at].assemblies.len() >= MAX_IN_FLIGHT;
            let full =
                writer.memory + cost > self.limits.max_memory_per_source || self.memory + cost > self.limits.max_memory;
            let oldest = if crowded {
                writer.sessions[at].assemblies.keys().next().map(|&oldest| (at, oldest))
            } else if full {
                writer.oldest_assembly()
            } else {
                return Ok(());
            };
            match oldest {
                Some((session, oldest)) if session != at || oldest < sequence => {
                    let freed = writer.give_up(session, oldest);
                    self.memory -= freed;
                    self.drops[DropReason::Evicted as usize] += 1;
                }
                _ => return Err(DropReason::MemoryFull),
            }
        }
    }

    fn deliver_if_complete(
        &mut self,
        source: Name,
        at: usize,
        header: &SegmentHeader,
        out: &mut Vec<Message>,
    ) -> Result<(), DropReason> {
        let writer = self.writers.get_mut(&source).ok_or(DropReason::Internal)?;
        let session = &mut writer.sessions[at];
        if !session.assemblies.get(&header.sequence).is_some_and(Assembly::is_complete) {
            return Ok(());
        }
        let assembly = session.assemblies.remove(&header.sequence).ok_or(DropReason::Internal)?;
        writer.memory -= assembly.cost;
        self.memory -= assembly.cost;

        let (plaintext, digests, proof) = assembly.into_parts();
        let leaf = wire::leaf(self.backend, &self.name, &source, header, &digests);
        writer.check_signature(self.backend, leaf, &proof)?;
        let (message_header, body_at) = MessageHeader::parse(&plaintext).ok_or(DropReason::BadMessage)?;
        if plaintext.len() - body_at > self.limits.max_message {
            return Err(DropReason::TooLarge);
        }
        let given_up = writer.accept(at, header.sequence, message_header.timestamp_ns, self.limits.max_sessions)?;
        self.memory -= given_up.freed;
        self.drops[DropReason::Evicted as usize] += given_up.messages;
        out.push(Message {
            name: self.name,
            writer: source,
            session: header.session,
            sequence: header.sequence,
            timestamp_ns: message_header.timestamp_ns,
            encoding: message_header.encoding,
            body: Bytes::from(plaintext).slice(body_at..),
        });
        Ok(())
    }
}

/// What forgetting a session cost.
#[derive(Default)]
struct GivenUp {
    freed: usize,
    messages: u64,
}

impl WriterState {
    /// A place for a session that has shown one authentic segment. If too many wait for their first signature, the one
    /// that waits longest goes. Returns the place, the bytes that became free and the messages given up.
    fn admit(&mut self, id: [u8; 16], aead: Aead, max_sessions: usize) -> (usize, usize, u64) {
        let waiting = self.sessions.iter().filter(|session| !session.proven).count();
        let mut given_up = GivenUp::default();
        if waiting >= max_sessions.max(1)
            && let Some(oldest) = self.sessions.iter().position(|session| !session.proven)
        {
            given_up = self.forget(oldest);
        }
        self.sessions.push(Session {
            id,
            aead,
            window: Window::new(),
            assemblies: BTreeMap::new(),
            proven: false,
            floor: 0,
            newest_timestamp: 0,
            last_used: 0,
        });
        (self.sessions.len() - 1, given_up.freed, given_up.messages)
    }

    /// A verified message: marks it as delivered. The first one of a session makes the session count; if there are too
    /// many of those, the one unused longest is forgotten, and whatever was signed up to its last message with it.
    fn accept(
        &mut self,
        at: usize,
        sequence: u64,
        timestamp_ns: u64,
        max_sessions: usize,
    ) -> Result<GivenUp, DropReason> {
        self.clock += 1;
        let session = &mut self.sessions[at];
        session.window.check(sequence)?;
        let floor = if session.proven { session.floor } else { session.floor.max(self.floor) };
        if floor > 0 && timestamp_ns <= floor {
            return Err(DropReason::Stale);
        }
        session.window.record(sequence);
        session.newest_timestamp = session.newest_timestamp.max(timestamp_ns);
        session.last_used = self.clock;
        session.floor = floor;
        let first = !std::mem::replace(&mut session.proven, true);
        if !first || self.sessions.iter().filter(|session| session.proven).count() <= max_sessions.max(1) {
            return Ok(GivenUp::default());
        }
        let unused = self.sessions.iter().enumerate().filter(|(_, session)| session.proven);
        let Some((unused, _)) = unused.min_by_key(|(_, session)| session.last_used) else {
            return Ok(GivenUp::default());
        };
        self.floor = self.floor.max(self.sessions[unused].newest_timestamp);
        Ok(self.forget(unused))
    }

    fn check_signature(&mut self, backend: Backend, leaf: [u8; 32], proof: &[u8]) -> Result<(), DropReason> {
        let proof = Proof::parse(proof).ok_or(DropReason::BadMessage)?;
        let root = merkle::root(backend, leaf, proof.position, proof.path);
        if self.verified_root != Some(root) {
            self.verifier
                .verify(&wire::batch_statement(&root), proof.signature)
                .map_err(|_| DropReason::BadSignature)?;
            self.verified_root = Some(root);
        }
        Ok(())
    }

    fn oldest_assembly(&self) -> Option<(usize, u64)> {
        let all = self.sessions.iter().enumerate().flat_map(|(at, session)| {
            session.assemblies.iter().map(move |(&sequence, assembly)| (assembly.deadline, at, sequence))
        });
        all.min().map(|(_, at, sequence)| (at, sequence))
    }

    /// Drops an incomplete message; returns the bytes that became free.
    fn give_up(&mut self, at: usize, sequence: u64) -> usize {
        let freed = self.sessions[at].assemblies.remove(&sequence).map_or(0, |assembly| assembly.cost);
        self.memory -= freed;
        freed
    }

    fn forget(&mut self, at: usize) -> GivenUp {
        let session = self.sessions.remove(at);
        let freed = session.assemblies.values().map(|assembly| assembly.cost).sum();
        self.memory -= freed;
        GivenUp { freed, messages: session.assemblies.len() as u64 }
    }
}

/// A segment whose fields fit each other; nothing in it is authentic yet.
struct Segment<'a> {
    header: SegmentHeader,
    clear: &'a [u8; HEADER_LEN],
    /// Ciphertext and tag.
    sealed: &'a [u8],
    plaintext_len: usize,
}

fn split_segment(payload: &[u8]) -> Result<(Segment<'_>, &[u8]), DropReason> {
    let (clear, rest) = payload.split_first_chunk::<HEADER_LEN>().ok_or(DropReason::Truncated)?;
    let header = SegmentHeader::parse(clear).ok_or(DropReason::BadHeader)?;
    let plaintext_len = header.plaintext_len().ok_or(DropReason::BadHeader)?;
    let (sealed, behind) = rest.split_at_checked(header.sealed_len.into()).ok_or(DropReason::Truncated)?;
    Ok((Segment { header, clear, sealed, plaintext_len }, behind))
}

impl Segment<'_> {
    fn open(&self, aead: &Aead, out: &mut [u8]) -> Result<(), DropReason> {
        let (ciphertext, tag) = self.sealed.split_last_chunk::<TAG_LEN>().ok_or(DropReason::BadHeader)?;
        aead.open(&self.header.nonce(), self.clear, ciphertext, tag, out).map_err(|_| DropReason::Forged)
    }

    fn digest(&self, backend: Backend) -> [u8; 32] {
        backend.sha256(&[self.sealed])
    }
}

impl fmt::Debug for Reader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, writers, memory, .. } = self;
        write!(f, "Reader {{ name: {name:#}, writers: {}, memory: {memory} }}", writers.len())
    }
}
