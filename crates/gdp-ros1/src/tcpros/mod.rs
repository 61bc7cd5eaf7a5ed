//! TCPROS: connection headers, then messages with length prefixes.
//! <https://wiki.ros.org/ROS/TCPROS>

pub mod header;
pub mod listener;
pub mod stream;

pub use header::{Header, HeaderError};
pub use stream::{Stream, TcprosError};
