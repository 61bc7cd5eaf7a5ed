//! JSON: one object for each message, with the names of the definition. [`crate`] describes the
//! form of the values.

mod scan;
mod sink;
mod source;

pub(crate) use sink::JsonSink;
pub(crate) use source::JsonSource;

use crate::definition::Scalar;

/// Largest absolute value of an integer that every JSON reader takes exactly. Larger ones are
/// written as strings.
const EXACT: u64 = 1 << 53;

/// Returns whether arrays of this scalar are base64 strings.
fn is_octet(kind: Scalar) -> bool {
    matches!(kind, Scalar::Byte | Scalar::Char | Scalar::UInt8)
}
