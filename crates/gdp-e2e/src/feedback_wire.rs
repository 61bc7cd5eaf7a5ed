//! The encoding of [`Feedback`] messages between the reader and the writer of a name.
//! `docs/wire-format.md`, "Feedback", specifies it. A message travels sealed between the two
//! ([`crate::keys`]), in a frame to the name of the receiver. The transport decides when to send
//! each message and how to react to it.

use gdp_core::cert::Signed;
use gdp_core::keys::KeyBox;
use gdp_wire::Name;

/// Maximum number of ranges in a [`Feedback::Nack`]. Sealed, they fit a frame of 1200 bytes, which
/// every link supports.
pub const MAX_MISSING: usize = 62;

/// The largest encoding, in bytes: a Nack with all its ranges. Several messages have no more
/// together.
pub const MAX_FEEDBACK: usize = NACK_LEN + MAX_MISSING * MISSING_LEN;

/// Sequences have 48 bits (`docs/wire-format.md`, "Sealed segments").
pub const MAX_SEQUENCE: u64 = (1 << 48) - 1;

const HELLO_LEN: usize = 1 + 32 + 16 + 1;
const WELCOME_LEN: usize = 1 + 32 + 16 + 16 + 8 + 4;
const REPORT_LEN: usize = 1 + 32 + 16 + 5 * 8 + 4 + 8 + 4 + 4;
const NACK_LEN: usize = 1 + 32 + 16 + 8 + 4 + 4 + 1;
const MISSING_LEN: usize = 6 + 2 + 4 + 4;
const UNAVAILABLE_LEN: usize = 1 + 32 + 16 + 8;
const CLOCK_LEN: usize = 1 + 32 + 16 + 16 + 8;
const CLOCK_ANSWER_LEN: usize = 1 + 32 + 16 + 8;
const NEWEST_KEY_LEN: usize = 1 + 32 + 2;

/// The largest wrapped key in a [`Feedback::NewestKey`], in bytes.
const MAX_KEY_BOX: usize = 768;

/// The messages that a reader requests from a writer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wants {
    /// The newest message.
    Newest = 0,
    /// Every message.
    Every = 1,
    /// Every message, if the writer offers that, and otherwise the newest.
    Offered = 2,
}

/// One message between a reader and a writer of `name`. Sequences are at most [`MAX_SEQUENCE`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Feedback {
    /// Reader → writer: requests the writer's current session.
    Hello { name: Name, challenge: [u8; 16], wants: Wants },
    /// Writer → reader, with the challenge of its Hello: the current session, and the first
    /// sequence for the reader. `history`: number of messages that the writer retains for
    /// retransmission; 0: best effort.
    Welcome { name: Name, challenge: [u8; 16], session: [u8; 16], sequence: u64, history: u32 },
    /// Reader → writer: the reception state of the writer's session.
    Report {
        name: Name,
        session: [u8; 16],
        /// The highest sequence with a received segment; 0 before the first.
        highest: u64,
        /// The last sequence up to which all messages are settled: delivered or given up.
        acknowledged: u64,
        /// Received segments, each counted once.
        received_segments: u64,
        /// Their bytes, including frame headers.
        received_bytes: u64,
        /// Bytes of segments that were requested and have arrived twice: their first transmission
        /// was late, not lost.
        needless_bytes: u64,
        /// Frames received with a congestion mark.
        ce: u32,
        /// The sequence of the last received segment, for the round-trip time. 0: none since the
        /// last report.
        echo: u64,
        /// The index of that segment.
        echo_index: u32,
        /// Microseconds between the arrival of that segment and this report.
        delay_us: u32,
    },
    /// Reader → writer: requests missing segments.
    Nack {
        name: Name,
        session: [u8; 16],
        /// The sequence and index of the received segment that was sent last; 0: none. With the
        /// time since its arrival, they tell which segments may still be in flight.
        highest: u64,
        highest_index: u32,
        /// Microseconds since that segment arrived.
        waited_us: u32,
        /// 1 to [`MAX_MISSING`] ranges, in ascending order of sequence and first index. Ranges of
        /// one message do not overlap.
        missing: Vec<Missing>,
    },
    /// Writer → reader, in answer to a Nack: messages before this sequence can no longer be
    /// repaired.
    Unavailable { name: Name, session: [u8; 16], oldest: u64 },
    /// Reader → writer of this session: what the writer signed is too old at this Unix time of the
    /// reader's, in nanoseconds. Requests the time of the writer.
    Clock { name: Name, session: [u8; 16], challenge: [u8; 16], unix_ns: u64 },
    /// Writer → reader, with the challenge of its Clock: the Unix time of the writer, in
    /// nanoseconds.
    ClockAnswer { name: Name, challenge: [u8; 16], unix_ns: u64 },
    /// Reader → writer: the newest wrapped key that the reader holds of this writer. A later one
    /// came with a lower epoch, which the reader does not take.
    NewestKey { name: Name, key_box: Signed<KeyBox> },
}

/// A range of segments of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Missing {
    pub sequence: u64,
    /// The cut of the message that the indices refer to.
    pub cut: u16,
    /// Index of the first segment.
    pub first: u32,
    /// At least 1; the last index fits 32 bits.
    pub count: u32,
}

impl Missing {
    /// Returns the range of a whole message without any received segment, for every cut.
    pub const fn whole(sequence: u64) -> Self {
        Self { sequence, cut: 0, first: 0, count: u32::MAX }
    }

    /// Returns the index of the last segment.
    pub fn last(&self) -> Option<u32> {
        self.first.checked_add(self.count.checked_sub(1)?)
    }
}

/// The reason that bytes are not valid feedback, or that feedback cannot be encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FeedbackError {
    #[error("feedback of kind {0}, which this version does not know")]
    Kind(u8),
    #[error("{got} bytes where this kind of feedback has {expected}")]
    Length { got: usize, expected: usize },
    #[error("a Nack with {0} ranges where 1 to {MAX_MISSING} are allowed")]
    Ranges(usize),
    #[error("ranges of a Nack that are empty, overlap or are not in ascending order")]
    Order,
    #[error("a flag of {0} where 0 to 2 are possible")]
    Flag(u8),
    #[error("sequence {0} where at most {MAX_SEQUENCE} is possible")]
    Sequence(u64),
    #[error("a wrapped key of {0} bytes where at most {MAX_KEY_BOX} are allowed")]
    KeyBox(usize),
}

impl Feedback {
    /// Returns the name that the message is about.
    pub fn name(&self) -> Name {
        match self {
            Self::Hello { name, .. }
            | Self::Welcome { name, .. }
            | Self::Report { name, .. }
            | Self::Nack { name, .. }
            | Self::Unavailable { name, .. }
            | Self::Clock { name, .. }
            | Self::ClockAnswer { name, .. }
            | Self::NewestKey { name, .. } => *name,
        }
    }

    /// Returns whether the message has a payload of its own. Releases that do not know its kind
    /// drop the whole payload.
    pub fn travels_alone(&self) -> bool {
        matches!(self, Self::Clock { .. } | Self::ClockAnswer { .. } | Self::NewestKey { .. })
    }

    /// Returns the length of the encoding in bytes.
    pub fn encoded_len(&self) -> usize {
        match self {
            Self::Hello { .. } => HELLO_LEN,
            Self::Welcome { .. } => WELCOME_LEN,
            Self::Report { .. } => REPORT_LEN,
            Self::Nack { missing, .. } => NACK_LEN + missing.len() * MISSING_LEN,
            Self::Unavailable { .. } => UNAVAILABLE_LEN,
            Self::Clock { .. } => CLOCK_LEN,
            Self::ClockAnswer { .. } => CLOCK_ANSWER_LEN,
            Self::NewestKey { key_box, .. } => NEWEST_KEY_LEN + key_box.as_bytes().len(),
        }
    }

    /// Appends the encoding to `out`. Appends nothing if a field is out of bounds.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), FeedbackError> {
        self.check()?;
        match self {
            Self::Hello { name, challenge, wants } => {
                put(out, &[&[kind::HELLO][..], name.as_bytes(), challenge, &[*wants as u8]]);
            }
            Self::Welcome { name, challenge, session, sequence, history } => {
                put(out, &[&[kind::WELCOME][..], name.as_bytes(), challenge, session, &sequence.to_be_bytes()]);
                put(out, &[history.to_be_bytes()]);
            }
            Self::Report {
                name,
                session,
                highest,
                acknowledged,
                received_segments,
                received_bytes,
                needless_bytes,
                ce,
                echo,
                echo_index,
                delay_us,
            } => {
                put(out, &[&[kind::REPORT][..], name.as_bytes(), session]);
                let counts = [highest, acknowledged, received_segments, received_bytes, needless_bytes];
                put(out, &counts.map(|count| count.to_be_bytes()));
                put(out, &[ce.to_be_bytes().as_slice(), &echo.to_be_bytes()]);
                put(out, &[echo_index, delay_us].map(|field| field.to_be_bytes()));
            }
            Self::Nack { name, session, highest, highest_index, waited_us, missing } => {
                put(out, &[&[kind::NACK][..], name.as_bytes(), session, &highest.to_be_bytes()]);
                put(out, &[highest_index, waited_us].map(|field| field.to_be_bytes()));
                out.push(missing.len() as u8);
                for Missing { sequence, cut, first, count } in missing {
                    put(out, &[&sequence.to_be_bytes()[2..], &cut.to_be_bytes()]);
                    put(out, &[first, count].map(|field| field.to_be_bytes()));
                }
            }
            Self::Unavailable { name, session, oldest } => {
                put(out, &[&[kind::UNAVAILABLE][..], name.as_bytes(), session, &oldest.to_be_bytes()]);
            }
            Self::Clock { name, session, challenge, unix_ns } => {
                put(out, &[&[kind::CLOCK][..], name.as_bytes(), session, challenge, &unix_ns.to_be_bytes()]);
            }
            Self::ClockAnswer { name, challenge, unix_ns } => {
                put(out, &[&[kind::CLOCK_ANSWER][..], name.as_bytes(), challenge, &unix_ns.to_be_bytes()]);
            }
            Self::NewestKey { name, key_box } => {
                let bytes = key_box.as_bytes();
                put(out, &[&[kind::NEWEST_KEY][..], name.as_bytes(), &(bytes.len() as u16).to_be_bytes(), bytes]);
            }
        }
        Ok(())
    }

    /// Returns the messages that `bytes` encode, one after the other. There is at least one. Every
    /// message has exactly one encoding.
    pub fn decode_all(mut bytes: &[u8]) -> Result<Vec<Self>, FeedbackError> {
        let mut messages = Vec::new();
        while messages.is_empty() || !bytes.is_empty() {
            let (message, rest) = Self::split(bytes)?;
            messages.push(message);
            bytes = rest;
        }
        Ok(messages)
    }

    /// Returns the first message of `bytes`, and the bytes after it.
    fn split(bytes: &[u8]) -> Result<(Self, &[u8]), FeedbackError> {
        let too_short = FeedbackError::Length { got: 0, expected: HELLO_LEN };
        let (&kind, _) = bytes.split_first().ok_or(too_short)?;
        let expected = match kind {
            kind::HELLO => HELLO_LEN,
            kind::WELCOME => WELCOME_LEN,
            kind::REPORT => REPORT_LEN,
            kind::NACK => match bytes.get(NACK_LEN - 1).map(|count| usize::from(*count)) {
                Some(count @ 1..=MAX_MISSING) => NACK_LEN + count * MISSING_LEN,
                Some(count) => return Err(FeedbackError::Ranges(count)),
                None => NACK_LEN,
            },
            kind::UNAVAILABLE => UNAVAILABLE_LEN,
            kind::CLOCK => CLOCK_LEN,
            kind::CLOCK_ANSWER => CLOCK_ANSWER_LEN,
            kind::NEWEST_KEY => match bytes.get(..NEWEST_KEY_LEN).and_then(<[u8]>::last_chunk) {
                Some(length) => NEWEST_KEY_LEN + usize::from(u16::from_be_bytes(*length)),
                None => NEWEST_KEY_LEN,
            },
            kind => return Err(FeedbackError::Kind(kind)),
        };
        let wrong_length = FeedbackError::Length { got: bytes.len(), expected };
        let (message, rest) = bytes.split_at_checked(expected).ok_or(wrong_length)?;
        if let (kind::HELLO, Some(&flag @ 3..)) = (kind, message.last()) {
            return Err(FeedbackError::Flag(flag));
        }
        // The length matches the kind, so no field is truncated.
        let feedback = Self::decode_fields(kind, &mut Fields(&message[1..])).ok_or(wrong_length)?;
        feedback.check()?;
        Ok((feedback, rest))
    }

    fn decode_fields(kind: u8, fields: &mut Fields<'_>) -> Option<Self> {
        let name = Name::from_bytes(fields.take()?);
        Some(match kind {
            kind::HELLO => Self::Hello { name, challenge: fields.take()?, wants: fields.wants()? },
            kind::WELCOME => {
                let (challenge, session) = (fields.take()?, fields.take()?);
                Self::Welcome { name, challenge, session, sequence: fields.u64()?, history: fields.u32()? }
            }
            kind::REPORT => Self::Report {
                name,
                session: fields.take()?,
                highest: fields.u64()?,
                acknowledged: fields.u64()?,
                received_segments: fields.u64()?,
                received_bytes: fields.u64()?,
                needless_bytes: fields.u64()?,
                ce: fields.u32()?,
                echo: fields.u64()?,
                echo_index: fields.u32()?,
                delay_us: fields.u32()?,
            },
            kind::UNAVAILABLE => Self::Unavailable { name, session: fields.take()?, oldest: fields.u64()? },
            kind::CLOCK => {
                let (session, challenge) = (fields.take()?, fields.take()?);
                Self::Clock { name, session, challenge, unix_ns: fields.u64()? }
            }
            kind::CLOCK_ANSWER => Self::ClockAnswer { name, challenge: fields.take()?, unix_ns: fields.u64()? },
            kind::NEWEST_KEY => {
                let [_, _] = fields.take()?;
                Self::NewestKey { name, key_box: Signed::from_bytes(fields.0.to_vec()).ok()? }
            }
            _ => {
                let (session, highest) = (fields.take()?, fields.u64()?);
                let (highest_index, waited_us) = (fields.u32()?, fields.u32()?);
                let [count] = fields.take()?;
                let missing = (0..count).map(|_| fields.missing()).collect::<Option<_>>()?;
                Self::Nack { name, session, highest, highest_index, waited_us, missing }
            }
        })
    }

    fn check(&self) -> Result<(), FeedbackError> {
        let sequence = |sequence: u64| match sequence {
            0..=MAX_SEQUENCE => Ok(()),
            _ => Err(FeedbackError::Sequence(sequence)),
        };
        match self {
            Self::Hello { .. } | Self::Clock { .. } | Self::ClockAnswer { .. } => Ok(()),
            Self::NewestKey { key_box, .. } => match key_box.as_bytes().len() {
                0..=MAX_KEY_BOX => Ok(()),
                len => Err(FeedbackError::KeyBox(len)),
            },
            Self::Welcome { sequence: from, .. } | Self::Unavailable { oldest: from, .. } => sequence(*from),
            Self::Report { highest, acknowledged, echo, .. } => {
                [highest, acknowledged, echo].into_iter().try_for_each(|number| sequence(*number))
            }
            Self::Nack { highest, missing, .. } => {
                sequence(*highest)?;
                if !(1..=MAX_MISSING).contains(&missing.len()) {
                    return Err(FeedbackError::Ranges(missing.len()));
                }
                missing.iter().try_for_each(|range| sequence(range.sequence))?;
                // Prevents a Nack from requesting the same segment twice.
                let follows =
                    |pair: &[Missing]| (pair[0].sequence, pair[0].last()) < (pair[1].sequence, Some(pair[1].first));
                let in_order = missing.windows(2).all(follows);
                let whole = missing.iter().all(|range| range.last().is_some());
                if in_order && whole { Ok(()) } else { Err(FeedbackError::Order) }
            }
        }
    }
}

mod kind {
    pub const HELLO: u8 = 1;
    pub const WELCOME: u8 = 2;
    pub const REPORT: u8 = 3;
    pub const NACK: u8 = 4;
    pub const UNAVAILABLE: u8 = 5;
    pub const CLOCK: u8 = 6;
    pub const CLOCK_ANSWER: u8 = 7;
    pub const NEWEST_KEY: u8 = 8;
}

fn put<T: AsRef<[u8]>>(out: &mut Vec<u8>, parts: &[T]) {
    parts.iter().for_each(|part| out.extend_from_slice(part.as_ref()));
}

struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (field, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*field)
    }

    fn wants(&mut self) -> Option<Wants> {
        match self.take()? {
            [0] => Some(Wants::Newest),
            [1] => Some(Wants::Every),
            [2] => Some(Wants::Offered),
            _ => None,
        }
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_be_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.take().map(u64::from_be_bytes)
    }

    fn missing(&mut self) -> Option<Missing> {
        let [a, b, c, d, e, f] = self.take()?;
        Some(Missing {
            sequence: u64::from_be_bytes([0, 0, a, b, c, d, e, f]),
            cut: self.take().map(u16::from_be_bytes)?,
            first: self.u32()?,
            count: self.u32()?,
        })
    }
}

#[cfg(test)]
#[path = "../tests/unit/feedback_wire.rs"]
mod tests;
