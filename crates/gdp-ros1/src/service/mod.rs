//! Services: what this node serves, and calls of others.

pub mod client;
pub mod server;
