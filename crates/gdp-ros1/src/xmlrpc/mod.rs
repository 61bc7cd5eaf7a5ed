//! XML-RPC as ROS 1 uses it, without I/O: calls and responses, and both as XML.
//! <http://xmlrpc.com/spec.md>
//!
//! Only what occurs in the master and slave API: integers, booleans, strings, arrays, and
//! structures (in faults). Whatever comes is bounded in depth and number; the bytes of a body are
//! bounded by who reads it. Entities other than XML's own five are not known, so that nothing is
//! ever expanded.

mod decode;
mod encode;
#[cfg(test)]
#[path = "../../tests/unit/xmlrpc.rs"]
mod tests;
mod value;

pub use decode::{MAX_DEPTH, MAX_VALUES, XmlRpcError, decode_call, decode_response};
pub use encode::{encode_call, encode_response};
pub use value::{Mismatch, Value};

/// Whether a character can stand in XML at all, escaped or not (XML 1.0, section 2.2).
fn is_allowed(c: char) -> bool {
    matches!(c, '\t' | '\n' | '\r' | '\u{20}'..) && !matches!(c, '\u{fffe}' | '\u{ffff}')
}

/// A method and what it is called with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Call {
    pub method: String,
    pub params: Vec<Value>,
}

/// What the other side could not even begin to answer: `faultCode` and `faultString`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("fault {code}: {text}")]
pub struct Fault {
    pub code: i32,
    pub text: String,
}
