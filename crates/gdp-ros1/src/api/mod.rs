//! The two XML-RPC interfaces of ROS 1: the master's, which a node calls, and the slave's, which
//! every node serves.

pub mod client;
pub mod master;
pub mod server;
pub mod slave;

pub use client::RpcError;
