//! Services: those that this node serves, and calls of others.

pub mod client;
pub mod server;
