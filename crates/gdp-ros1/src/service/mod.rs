//! The services that this node serves, and its calls to services of other nodes.

pub mod client;
pub mod server;
