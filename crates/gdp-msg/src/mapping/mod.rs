//! Transcodes from one type and encoding to another. [`Mapping::new`] compiles a program once;
//! [`Mapping::transcode`] runs it for each message.

mod compile;
mod options;
mod pair;
mod program;
mod run;

pub use crate::mapping::options::{Note, Options};
use std::sync::Arc;

use crate::encode::cdr::{CdrSink, CdrSource};
use crate::encode::json::{JsonSink, JsonSource};
use crate::encode::nothing::Nowhere;
use crate::encode::output::Output;
use crate::encode::ros1::{Ros1Sink, Ros1Source};
use crate::encode::{Encoding, Fault, Sink, Source};
use crate::schema::Schema;
use program::{Op, Program};

pub use compile::MapError;

/// How messages of one type and encoding become messages of another. `Send` and `Sync`; nothing in
/// it changes.
#[derive(Debug)]
pub struct Mapping {
    from: Encoding,
    to: Encoding,
    program: Program,
    notes: Vec<Note>,
}

/// A message that was refused.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{}at byte {offset}: {fault}", if path.is_empty() { String::new() } else { format!("`{path}`, ") })]
pub struct TranscodeError {
    /// Of the field, with the indices of its elements: `poses[3].position.x`. Empty where the
    /// message as a whole is meant.
    pub path: String,
    /// How far the message was read, in bytes.
    pub offset: usize,
    pub fault: Fault,
}

impl Mapping {
    /// Types map if they have the same fields, by name (whatever its case) or, where as many are
    /// left on both sides, by position. Of two versions of one type, also if one of them has more
    /// fields; see [`Mapping::notes`].
    ///
    /// # Errors
    /// Says where the types differ.
    pub fn new(from: &Schema, from_encoding: Encoding, to: &Schema, to_encoding: Encoding) -> Result<Self, MapError> {
        Self::with_frame_prefix(from, from_encoding, to, to_encoding, "")
    }

    /// The same, and `prefix` goes in front of each coordinate frame: `frame_id` of every
    /// `std_msgs/Header`, and every text called `child_frame_id`. A `/` that a frame begins with,
    /// as in old ROS 1, is dropped; a frame that is empty stays so.
    ///
    /// # Errors
    /// As [`Mapping::new`].
    pub fn with_frame_prefix(
        from: &Schema,
        from_encoding: Encoding,
        to: &Schema,
        to_encoding: Encoding,
        prefix: &str,
    ) -> Result<Self, MapError> {
        let (program, notes) = compile::compile(from, from_encoding, to, to_encoding, prefix)?;
        Ok(Self { from: from_encoding, to: to_encoding, program, notes })
    }

    /// Of messages that stay of one type.
    ///
    /// # Errors
    /// If a message of the type takes too many steps.
    pub fn within(schema: &Arc<Schema>, from: Encoding, to: Encoding) -> Result<Self, MapError> {
        Self::new(schema, from, schema, to)
    }

    /// What gets lost, and what is made up. Not a header's `seq`, which is known to.
    pub fn notes(&self) -> &[Note] {
        &self.notes
    }

    /// Whether messages of the type have frames that get the prefix.
    pub fn prefixes_frames(&self) -> bool {
        self.program.ops.iter().any(|op| matches!(op, Op::Frame { .. }))
    }

    /// Writes `input` into `output`, instead of what is in there. Its memory is used again; more is
    /// taken as input is read, a few times its length at most, and never beyond the limit.
    ///
    /// # Errors
    /// For input that is no message of the type; then `output` is empty.
    pub fn transcode(&self, input: &[u8], output: &mut Vec<u8>, options: &Options) -> Result<(), TranscodeError> {
        output.clear();
        // What most messages need, so that memory is not moved while they grow.
        output.reserve(input.len().saturating_add(input.len() / 8).saturating_add(64).min(options.max_output));
        let out = Output { bytes: output, most: options.max_output };
        let done = match self.to {
            Encoding::Cdr => CdrSink::new(out, false).map_err(whole).and_then(|sink| self.to(input, sink, options)),
            Encoding::CdrBigEndian => {
                CdrSink::new(out, true).map_err(whole).and_then(|sink| self.to(input, sink, options))
            }
            Encoding::Ros1 => self.to(input, Ros1Sink(out), options),
            Encoding::Json => self.to(input, JsonSink(out), options),
        };
        if done.is_err() {
            output.clear();
        }
        done
    }

    /// Reads `input` without writing anything.
    ///
    /// # Errors
    /// For input that is no message of the type.
    pub fn validate(&self, input: &[u8]) -> Result<(), TranscodeError> {
        self.to(input, Nowhere, &Options::default())
    }

    fn to(&self, input: &[u8], sink: impl Sink, options: &Options) -> Result<(), TranscodeError> {
        match self.from {
            Encoding::Cdr | Encoding::CdrBigEndian => self.run(CdrSource::new(input).map_err(whole)?, sink, options),
            Encoding::Ros1 => self.run(Ros1Source::new(input), sink, options),
            Encoding::Json => self.run(JsonSource::new(input).map_err(whole)?, sink, options),
        }
    }

    fn run(&self, mut source: impl Source, mut sink: impl Sink, options: &Options) -> Result<(), TranscodeError> {
        let failure = match run::run(&self.program, &mut source, &mut sink, options) {
            Ok(()) => return source.finish().map_err(|fault| at(source.offset(), fault)),
            Err(failure) => failure,
        };
        let path = self.program.path(failure.op, &failure.indices);
        Err(TranscodeError { path, offset: source.offset(), fault: failure.fault })
    }
}

fn whole(fault: Fault) -> TranscodeError {
    at(0, fault)
}

fn at(offset: usize, fault: Fault) -> TranscodeError {
    TranscodeError { path: String::new(), offset, fault }
}
