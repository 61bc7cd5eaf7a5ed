//! JSON: one object for each message, with the names of the definition. See [`crate`] for how
//! values are written.

mod scan;
mod sink;
mod source;

pub(crate) use sink::JsonSink;
pub(crate) use source::JsonSource;

use crate::definition::Scalar;

/// Up to here, either side of zero, every reader of JSON takes integers for what they are. Beyond
/// it they are written as strings.
const EXACT: u64 = 1 << 53;

/// Whether arrays of these are a base64 string.
fn is_octet(kind: Scalar) -> bool {
    matches!(kind, Scalar::Byte | Scalar::Char | Scalar::UInt8)
}
