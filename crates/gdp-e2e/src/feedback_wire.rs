//! What the reader and the writer of a name tell each other: the bytes of one [`Feedback`] message,
//! specified in `docs/wire-format.md`, "Feedback". It travels sealed between the two
//! ([`crate::keys`]), in a frame to the other's own name. When each is sent, and what follows from
//! it, is the transport's; nothing is decided here.

use gdp_wire::Name;

/// Ranges that one [`Feedback::Nack`] may ask for: as many as fit, sealed, a frame of 1200 bytes,
/// which every link takes.
pub const MAX_MISSING: usize = 63;

/// The largest encoding, in bytes: a Nack with all its ranges.
pub const MAX_FEEDBACK: usize = NACK_LEN + MAX_MISSING * MISSING_LEN;

/// Sequences have 48 bits (`docs/wire-format.md`, "Sealed segments").
pub const MAX_SEQUENCE: u64 = (1 << 48) - 1;

const HELLO_LEN: usize = 1 + 32 + 16 + 1;
const WELCOME_LEN: usize = 1 + 32 + 16 + 16 + 8 + 1;
const REPORT_LEN: usize = 1 + 32 + 16 + 4 * 8 + 4 + 8 + 4 + 4;
const NACK_LEN: usize = 1 + 32 + 16 + 1;
const MISSING_LEN: usize = 6 + 2 + 4 + 4;
const UNAVAILABLE_LEN: usize = 1 + 32 + 16 + 8;

/// What a reader asks of a writer.
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
    /// Reader → writer: which session is yours now?
    Hello { name: Name, challenge: [u8; 16], wants: Wants },
    /// Writer → reader, with the challenge of its Hello: this session, and in it what comes from
    /// this sequence on. `reliable`: every message is kept to be asked for again.
    Welcome { name: Name, challenge: [u8; 16], session: [u8; 16], sequence: u64, reliable: bool },
    /// Reader → writer: what has come of the writer's session so far.
    Report {
        name: Name,
        session: [u8; 16],
        /// The highest sequence of which any segment has come; 0 before there is one.
        highest: u64,
        /// This sequence and all before it are done with: delivered, or given up.
        acknowledged: u64,
        /// Segments that have come, each counted once.
        received_segments: u64,
        /// Their bytes, as in frames.
        received_bytes: u64,
        /// Frames that came with a congestion mark.
        ce: u32,
        /// The sequence of the segment that came last, for the round-trip time; 0: none since the
        /// last report.
        echo: u64,
        /// Its index.
        echo_index: u32,
        /// Microseconds between its arrival and this report.
        delay_us: u32,
    },
    /// Reader → writer: these did not come.
    Nack {
        name: Name,
        session: [u8; 16],
        /// 1 to [`MAX_MISSING`], in ascending order of sequence and first index, none of a message
        /// overlapping another.
        missing: Vec<Missing>,
    },
    /// Writer → reader, in answer to a Nack: what came before this sequence cannot be repaired any
    /// more.
    Unavailable { name: Name, session: [u8; 16], oldest: u64 },
}

/// A range of segments of one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Missing {
    pub sequence: u64,
    /// Which cut of the message the indices are of.
    pub cut: u16,
    /// Index of the first segment.
    pub first: u32,
    /// At least 1; the last index fits 32 bits.
    pub count: u32,
}

impl Missing {
    /// All of a message of which nothing has come, however it was cut.
    pub const fn whole(sequence: u64) -> Self {
        Self { sequence, cut: 0, first: 0, count: u32::MAX }
    }

    /// Index of the last segment.
    pub fn last(&self) -> Option<u32> {
        self.first.checked_add(self.count.checked_sub(1)?)
    }
}

/// Why bytes are no feedback, or feedback has no bytes.
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
    #[error("a flag of {0} where 0 and 1 are possible")]
    Flag(u8),
    #[error("sequence {0} where at most {MAX_SEQUENCE} is possible")]
    Sequence(u64),
}

impl Feedback {
    /// What it is about.
    pub fn name(&self) -> Name {
        match self {
            Self::Hello { name, .. }
            | Self::Welcome { name, .. }
            | Self::Report { name, .. }
            | Self::Nack { name, .. }
            | Self::Unavailable { name, .. } => *name,
        }
    }

    /// Appends its encoding to `out`; nothing if it is not within the bounds.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), FeedbackError> {
        self.check()?;
        match self {
            Self::Hello { name, challenge, wants } => {
                put(out, &[&[kind::HELLO][..], name.as_bytes(), challenge, &[*wants as u8]]);
            }
            Self::Welcome { name, challenge, session, sequence, reliable } => {
                put(out, &[&[kind::WELCOME][..], name.as_bytes(), challenge, session, &sequence.to_be_bytes()]);
                out.push(u8::from(*reliable));
            }
            Self::Report {
                name,
                session,
                highest,
                acknowledged,
                received_segments,
                received_bytes,
                ce,
                echo,
                echo_index,
                delay_us,
            } => {
                put(out, &[&[kind::REPORT][..], name.as_bytes(), session]);
                put(out, &[highest, acknowledged, received_segments, received_bytes].map(|field| field.to_be_bytes()));
                put(out, &[ce.to_be_bytes().as_slice(), &echo.to_be_bytes()]);
                put(out, &[echo_index, delay_us].map(|field| field.to_be_bytes()));
            }
            Self::Nack { name, session, missing } => {
                put(out, &[&[kind::NACK][..], name.as_bytes(), session, &[missing.len() as u8]]);
                for Missing { sequence, cut, first, count } in missing {
                    put(out, &[&sequence.to_be_bytes()[2..], &cut.to_be_bytes()]);
                    put(out, &[first, count].map(|field| field.to_be_bytes()));
                }
            }
            Self::Unavailable { name, session, oldest } => {
                put(out, &[&[kind::UNAVAILABLE][..], name.as_bytes(), session, &oldest.to_be_bytes()]);
            }
        }
        Ok(())
    }

    /// The message whose only encoding `bytes` are.
    pub fn decode(bytes: &[u8]) -> Result<Self, FeedbackError> {
        let too_short = FeedbackError::Length { got: 0, expected: HELLO_LEN };
        let (&kind, rest) = bytes.split_first().ok_or(too_short)?;
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
            kind => return Err(FeedbackError::Kind(kind)),
        };
        let wrong_length = FeedbackError::Length { got: bytes.len(), expected };
        if bytes.len() != expected {
            return Err(wrong_length);
        }
        if let (kind::HELLO, Some(&flag @ 3..)) | (kind::WELCOME, Some(&flag @ 2..)) = (kind, bytes.last()) {
            return Err(FeedbackError::Flag(flag));
        }
        // The length was that of the kind, so no field is cut off.
        let feedback = Self::decode_fields(kind, &mut Fields(rest)).ok_or(wrong_length)?;
        feedback.check()?;
        Ok(feedback)
    }

    fn decode_fields(kind: u8, fields: &mut Fields<'_>) -> Option<Self> {
        let name = Name::from_bytes(fields.take()?);
        Some(match kind {
            kind::HELLO => Self::Hello { name, challenge: fields.take()?, wants: fields.wants()? },
            kind::WELCOME => {
                let (challenge, session) = (fields.take()?, fields.take()?);
                Self::Welcome { name, challenge, session, sequence: fields.u64()?, reliable: fields.flag()? }
            }
            kind::REPORT => Self::Report {
                name,
                session: fields.take()?,
                highest: fields.u64()?,
                acknowledged: fields.u64()?,
                received_segments: fields.u64()?,
                received_bytes: fields.u64()?,
                ce: fields.u32()?,
                echo: fields.u64()?,
                echo_index: fields.u32()?,
                delay_us: fields.u32()?,
            },
            kind::UNAVAILABLE => Self::Unavailable { name, session: fields.take()?, oldest: fields.u64()? },
            _ => {
                let session = fields.take()?;
                let [count] = fields.take()?;
                let missing = (0..count).map(|_| fields.missing()).collect::<Option<_>>()?;
                Self::Nack { name, session, missing }
            }
        })
    }

    fn check(&self) -> Result<(), FeedbackError> {
        let sequence = |sequence: u64| match sequence {
            0..=MAX_SEQUENCE => Ok(()),
            _ => Err(FeedbackError::Sequence(sequence)),
        };
        match self {
            Self::Hello { .. } => Ok(()),
            Self::Welcome { sequence: from, .. } | Self::Unavailable { oldest: from, .. } => sequence(*from),
            Self::Report { highest, acknowledged, echo, .. } => {
                [highest, acknowledged, echo].into_iter().try_for_each(|number| sequence(*number))
            }
            Self::Nack { missing, .. } => {
                if !(1..=MAX_MISSING).contains(&missing.len()) {
                    return Err(FeedbackError::Ranges(missing.len()));
                }
                missing.iter().try_for_each(|range| sequence(range.sequence))?;
                // So nobody makes a writer send one segment twice by one message.
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

    fn flag(&mut self) -> Option<bool> {
        self.take().map(|[flag]| flag == 1)
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
