//! Runs the program of a mapping on one message.

use super::program::{Op, Program, Text};
use crate::definition::{Count, Scalar};
use crate::encode::nothing::{Nowhere, Zeros};
use crate::encode::{Fault, Result, Sink, Source};
use crate::mapping::options::Options;

/// Maximum number of elements and empty messages without bytes in one message. ROS 1 encodes these
/// in no bytes, so the length of the message does not bound them.
const MAX_NOTHING: u32 = 1 << 16;

/// The step at which a program failed.
pub(super) struct Failure {
    pub op: usize,
    /// The indices of the elements on the path to it, innermost first.
    pub indices: Vec<u32>,
    pub fault: Fault,
}

pub(super) fn run(
    program: &Program,
    source: &mut impl Source,
    sink: &mut impl Sink,
    options: &Options,
) -> Result<(), Box<Failure>> {
    let mut run = Run { program, header_seq: options.header_seq, nothing: MAX_NOTHING, frame: Vec::new() };
    run.body(0, program.ops.len(), source, sink)
}

struct Run<'a> {
    program: &'a Program,
    header_seq: u32,
    /// Number of further elements without bytes that are allowed.
    nothing: u32,
    /// Buffer for a frame with its prefix.
    frame: Vec<u8>,
}

impl Run<'_> {
    /// Runs the steps from `at` up to `end`.
    fn body<S: Source, K: Sink>(
        &mut self,
        mut at: usize,
        end: usize,
        source: &mut S,
        sink: &mut K,
    ) -> Result<(), Box<Failure>> {
        while at < end {
            let body = match self.program.ops[at] {
                Op::Repeat { count, body, least } => {
                    self.repeat(at, count, body as usize, least, source, sink)?;
                    body
                }
                Op::Drop { body } => {
                    self.body(at + 1, at + 1 + body as usize, source, &mut Nowhere)?;
                    body
                }
                Op::Fill { body } if K::DISCARDS => body,
                Op::Fill { body } => {
                    self.body(at + 1, at + 1 + body as usize, &mut Zeros, sink)?;
                    body
                }
                op => {
                    self.simple(op, source, sink).map_err(failed(at))?;
                    0
                }
            };
            at += 1 + body as usize;
        }
        Ok(())
    }

    fn simple<S: Source, K: Sink>(&mut self, op: Op, source: &mut S, sink: &mut K) -> Result<()> {
        let members = |index: u32| &self.program.members[index as usize][..];
        match op {
            Op::Scalars { from, to, count: 1 } => sink.scalar(to, source.scalar(from)?),
            Op::Scalars { from, to, count } => self.array(from, to, Count::Fixed(count), 1, source, sink),
            Op::Array { from, to, count, per } => self.array(from, to, count, per, source, sink),
            Op::Narrow { from, to } => {
                let bits = source.scalar(from)?;
                if bits as u32 as i32 >= 0 {
                    return sink.scalar(to, bits);
                }
                let value = if from == Scalar::Int32 { i64::from(bits as u32 as i32) } else { bits as i64 };
                Err(Fault::Range(value, to.name()))
            }
            Op::Text { from, to } => {
                let text = source.text(from.wide)?;
                bounded(from, text)?;
                bounded(to, text)?;
                sink.text(to.wide, text)
            }
            Op::Frame { from, to } => {
                let text = source.text(from.wide)?;
                bounded(from, text)?;
                let text = text.strip_prefix(b"/").unwrap_or(text);
                self.frame.clear();
                if !text.is_empty() {
                    self.frame.extend_from_slice(self.program.frame_prefix.as_bytes());
                    self.frame.extend_from_slice(text);
                }
                bounded(to, &self.frame)?;
                sink.text(to.wide, &self.frame)
            }
            Op::Open { from } => {
                source.open(members(from))?;
                sink.open()
            }
            Op::Take { from, member } => source.take(members(from), member as usize),
            Op::Put { to, member } => sink.put(members(to), member as usize),
            Op::Close { from } => {
                source.close(members(from))?;
                sink.close()
            }
            Op::Empty => {
                self.take_nothing(1)?;
                source.empty()?;
                sink.empty()
            }
            Op::Seq { is_first } => {
                let seq = if is_first { self.header_seq } else { 0 };
                sink.scalar(Scalar::UInt32, seq.into())
            }
            Op::Repeat { .. } | Op::Drop { .. } | Op::Fill { .. } => Ok(()),
        }
    }

    fn take_nothing(&mut self, elements: u32) -> Result<()> {
        self.nothing = self.nothing.checked_sub(elements).ok_or(Fault::Nothing(MAX_NOTHING))?;
        Ok(())
    }

    fn array<S: Source, K: Sink>(
        &mut self,
        from: Scalar,
        to: Scalar,
        count: Count,
        per: u32,
        source: &mut S,
        sink: &mut K,
    ) -> Result<()> {
        if let Some(block) = source.array(from, count, per)? {
            allowed(count, (block.bytes.len() / from.size() / per as usize) as u64)?;
            return sink.array(to, count, per, block);
        }
        let known = source.begin(count, 0)?;
        let mark = sink.begin(count, known)?;
        let mut done = 0;
        while known.map_or_else(|| source.more(done), |known| Ok(done < known))? {
            sink.element(done)?;
            sink.scalar(to, source.scalar(from)?)?;
            done += 1;
        }
        allowed(count, done.into())?;
        sink.end(count, known, mark, done)
    }

    fn repeat<S: Source, K: Sink>(
        &mut self,
        at: usize,
        count: Count,
        body: usize,
        least: u64,
        source: &mut S,
        sink: &mut K,
    ) -> Result<(), Box<Failure>> {
        let known = source.begin(count, least).map_err(failed(at))?;
        if let Some(known) = known {
            allowed(count, known.into()).map_err(failed(at))?;
            if least == 0 {
                self.take_nothing(known).map_err(failed(at))?;
            }
        }
        let mark = sink.begin(count, known).map_err(failed(at))?;
        let mut done = 0;
        while known.map_or_else(|| source.more(done), |known| Ok(done < known)).map_err(failed(at))? {
            sink.element(done).map_err(failed(at))?;
            self.body(at + 1, at + 1 + body, source, sink).map_err(|mut failure| {
                failure.indices.push(done);
                failure
            })?;
            done += 1;
        }
        allowed(count, done.into()).and_then(|()| sink.end(count, known, mark, done)).map_err(failed(at))
    }
}

fn failed(op: usize) -> impl Fn(Fault) -> Box<Failure> {
    move |fault| Box::new(Failure { op, indices: Vec::new(), fault })
}

fn allowed(count: Count, elements: u64) -> Result<()> {
    match count {
        Count::Fixed(length) if elements != u64::from(length) => Err(Fault::Count(elements, length.into())),
        Count::Sequence(Some(bound)) if elements > u64::from(bound) => Err(Fault::Count(elements, bound.into())),
        _ => Ok(()),
    }
}

fn bounded(text: Text, bytes: &[u8]) -> Result<()> {
    let Some(most) = text.most else { return Ok(()) };
    let length = match str::from_utf8(bytes) {
        Ok(bytes) if text.wide => bytes.encode_utf16().count(),
        _ => bytes.len(),
    };
    if length <= most as usize { Ok(()) } else { Err(Fault::Bound(length, most)) }
}
