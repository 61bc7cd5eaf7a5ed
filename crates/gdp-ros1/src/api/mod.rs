//! The two XML-RPC interfaces of ROS 1. A node calls the master API, and serves the slave API.

pub mod client;
pub mod master;
pub mod server;
pub mod slave;

pub use client::RpcError;
