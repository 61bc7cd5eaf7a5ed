//! Topics: what this node publishes, and what it subscribes to.

pub mod link;
mod message;
pub mod publication;
pub mod sources;
pub mod subscription;
