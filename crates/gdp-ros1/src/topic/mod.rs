//! Topics: publications and subscriptions of this node.

pub mod link;
mod message;
pub mod publication;
pub mod sources;
pub mod subscription;
