//! XML-RPC as ROS 1 uses it, without I/O: calls and responses, and their encoding as XML.
//! <http://xmlrpc.com/spec.md>
//!
//! It supports only the values of the master and slave API: integers, booleans, strings, arrays,
//! and structures (in faults). The decoder bounds the depth and number of values; its caller bounds
//! the bytes of a body. It knows only XML's five predefined entities, so nothing is ever expanded.

mod decode;
mod encode;
#[cfg(test)]
#[path = "../../tests/unit/xmlrpc.rs"]
mod tests;
mod value;

pub use decode::{MAX_DEPTH, MAX_VALUES, XmlRpcError, decode_call, decode_response};
pub use encode::{encode_call, encode_response};
pub use value::{Mismatch, Value};

/// Returns whether XML allows a character, escaped or not (XML 1.0, section 2.2).
fn is_allowed(c: char) -> bool {
    matches!(c, '\t' | '\n' | '\r' | '\u{20}'..) && !matches!(c, '\u{fffe}' | '\u{ffff}')
}

/// A method with its parameters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Call {
    pub method: String,
    pub params: Vec<Value>,
}

/// A response that reports a fault of the whole call: `faultCode` and `faultString`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("fault {code}: {text}")]
pub struct Fault {
    pub code: i32,
    pub text: String,
}
