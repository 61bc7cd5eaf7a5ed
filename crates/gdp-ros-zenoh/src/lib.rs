//! A node in a graph of rmw_zenoh, the middleware of ROS 2 on Zenoh, for bridges. It publishes,
//! subscribes, serves and calls without any type at compile time.
//!
//! A node or endpoint exists by its liveliness [`Token`], messages are CDR with an [`Attachment`],
//! and a service is a queryable. The formats are those that rmw_zenoh_cpp 0.6.7 uses:
//!
//! - [`token`], [`qos`], [`key`] and [`attachment`] read and write them. They do no I/O.
//! - A [`ZenohNode`] is a client of one router. It connects again whenever it loses the router.
//! - A [`RawPublisher`] is on behalf of any node, so a bridge shows remote nodes by their names.
//! - A [`RawSubscriber`] puts checked messages into a bounded [`Inbox`].
//! - A [`RawClient`] calls servers, and a [`RawServer`] receives requests.
//!
//! Everything that others send is hostile. The graph is bounded by [`MAX_TOKENS`], a message by
//! [`MAX_MESSAGE`], and queues in messages and bytes. An attachment is never relayed, because a
//! short one aborts the process of its receiver.

pub mod attachment;
mod client;
mod inbox;
pub mod key;
mod node;
mod publisher;
pub mod qos;
mod roll;
mod server;
mod subscriber;
mod table;
pub mod token;
mod topic;

pub use attachment::Attachment;
pub use client::{QueryError, RawClient};
pub use inbox::{Inbox, MessageError, NotCarried, Received};
pub use key::TypeHash;
pub use node::{Locator, LocatorError, ZenohError, ZenohNode};
pub use publisher::RawPublisher;
pub use qos::Qos;
pub use server::{RawServer, ReceivedQuery, Reply};
pub use subscriber::RawSubscriber;
pub use table::{Entity, MAX_TOKENS, Snapshot};
pub use token::{Endpoint, Gid, Role, Token};
pub use topic::Topic;

/// Bound on one message in bytes.
pub const MAX_MESSAGE: usize = 64 << 20;
