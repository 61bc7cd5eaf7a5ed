//! Transcodes messages from one type and encoding to another. [`Mapping::new`] compiles a program
//! once; [`Mapping::transcode`] runs it for each message.

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

/// A compiled mapping from one type and encoding to another. It is immutable, `Send` and `Sync`.
#[derive(Debug)]
pub struct Mapping {
    from: Encoding,
    to: Encoding,
    program: Program,
    notes: Vec<Note>,
}

/// The reason why a message was refused.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{}at byte {offset}: {fault}", if path.is_empty() { String::new() } else { format!("`{path}`, ") })]
pub struct TranscodeError {
    /// The path of the field, with the indices of elements: `poses[3].position.x`. It is empty if
    /// the error concerns the whole message.
    pub path: String,
    /// The position of the reader in the input, in bytes.
    pub offset: usize,
    pub fault: Fault,
}

impl Mapping {
    /// Compiles a mapping. Fields pair by name, ignoring case. The others pair by position if both
    /// sides have the same number left. Between two versions of one type, one side may have more
    /// fields; see [`Mapping::notes`].
    ///
    /// # Errors
    /// If the types differ; the error says where.
    pub fn new(from: &Schema, from_encoding: Encoding, to: &Schema, to_encoding: Encoding) -> Result<Self, MapError> {
        Self::with_frame_prefix(from, from_encoding, to, to_encoding, "")
    }

    /// Compiles a mapping that also puts `prefix` before each coordinate frame. Frames are the
    /// `frame_id` of every `std_msgs/Header`, and every text named `child_frame_id`. The mapping
    /// drops a leading `/` of a frame, as in old ROS 1. An empty frame stays empty.
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

    /// Compiles a mapping between two encodings of one type.
    ///
    /// # Errors
    /// If a message of the type takes too many steps.
    pub fn within(schema: &Arc<Schema>, from: Encoding, to: Encoding) -> Result<Self, MapError> {
        Self::new(schema, from, schema, to)
    }

    /// Returns the fields that are dropped or filled, except a header's `seq`.
    pub fn notes(&self) -> &[Note] {
        &self.notes
    }

    /// Returns whether the type has frames that get the prefix.
    pub fn prefixes_frames(&self) -> bool {
        self.program.ops.iter().any(|op| matches!(op, Op::Frame { .. }))
    }

    /// Replaces the content of `output` with the transcoded `input`. Reuses the memory of `output`.
    /// Further memory is allocated as input is read, up to a few times its length and never beyond
    /// the limit.
    ///
    /// # Errors
    /// If the input is not a message of the type; then `output` is empty.
    pub fn transcode(&self, input: &[u8], output: &mut Vec<u8>, options: &Options) -> Result<(), TranscodeError> {
        output.clear();
        // Enough for most messages, so that the buffer need not move while it grows.
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
    /// If the input is not a message of the type.
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
