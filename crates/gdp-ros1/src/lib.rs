//! A ROS 1 node for bridges. It publishes, subscribes, serves and calls without any type at compile
//! time.
//!
//! It is a node like those of roscpp and rospy: one name, one slave API (XML-RPC), one TCPROS port,
//! at one master. A process may have several nodes, at several masters. Unlike there, messages,
//! requests and responses are bytes in ROS 1 serialization, and types are strings:
//!
//! - A [`Subscription`] connects with `type=*` and `md5sum=*`, as `rostopic` does. It reads the
//!   type, md5sum, message definition and latching of each publisher from the connection header
//!   ([`PublisherInfo`]). Each message names its publisher, so a bridge can recognize messages of
//!   another bridge. A node never receives its own messages.
//! - A [`Publisher`] has a fixed type ([`MessageType`]). With `latch`, each new subscriber receives
//!   the last message.
//! - A [`ServiceServer`] calls a function for each request. A [`ServiceClient`] finds out the type
//!   of a service by a probe.
//! - A [`Graph`] watches the master for new and removed topics and services.
//!
//! ```no_run
//! # async fn bridge() -> Result<(), Box<dyn std::error::Error>> {
//! use gdp_ros1::{MessageType, Node, NodeConfig, PublishOptions, SubscribeOptions};
//!
//! let node = Node::start(NodeConfig::from_env("/repeater")).await?;
//! let mut camera = node.subscribe("/camera/image", SubscribeOptions::default())?;
//! let Some(first) = camera.next().await else { return Ok(()) };
//! let from = &first.publisher;
//! let kind = MessageType { name: from.kind.clone(), md5sum: from.md5sum.clone(), definition: from.definition.clone() };
//! let repeated = node.publish("/repeated", kind, PublishOptions { latch: from.latching, ..PublishOptions::default() })?;
//! repeated.publish(first.data)?;
//! node.leave().await;
//! # Ok(())
//! # }
//! ```
//!
//! # The master
//!
//! No function waits for the master. The node registers its topics and services as soon as it can
//! reach the master; [`Node::status`] shows the state. Every [`NodeConfig::poll`] the node requests
//! the master's system state, and registers again what that lacks. So a restarted master knows the
//! node after one period. A subscription also registers again when the state shows other publishers
//! than before. So a lost `publisherUpdate` delays a new publisher by one period at most.
//!
//! Connections do not depend on the master. A restarted master lists only the publishers that
//! registered with it, and roscpp and rospy nodes register only once. So a connection ends when its
//! publisher closes it or when it breaks. It also ends when a master that has listed the publisher
//! stops doing so, but not because a new master never listed it. While a publisher is listed, the
//! subscription reconnects after 200 ms, with a backoff that grows to 10 s ([`SourceState::Failed`]
//! holds the error).
//!
//! If two nodes have the same name, the later one owns it, as everywhere in ROS 1. The earlier one
//! shows [`MasterState::NameTaken`] and waits until the name is free. A `shutdown` call (`rosnode
//! kill`) only sets [`Status::shutdown`]. The application decides whether to end, because anybody
//! in the network can make this call.
//!
//! # Bounds
//!
//! ROS 1 has no authentication, so a node does not trust its peers. Memory for a message grows with
//! the bytes received, up to [`NodeConfig::max_message`]. A longer message ends its connection, and
//! [`Subscription::sources`] shows the error. A slow subscriber has a queue of [`QueueLimits`],
//! which drops and counts the oldest messages. Headers, XML-RPC bodies, their depth and number of
//! values, connections, handshakes and timeouts are bounded as well, by constants in the modules.
//!
//! # What is not here
//!
//! Parameters, UDPROS, `/rosout`, simulated time, remappings and intraprocess shortcuts. The
//! application applies remappings; this crate resolves and validates names. `getBusStats` returns
//! empty lists.
//!
//! # How it is built
//!
//! These parts do no I/O:
//!
//! - [`xmlrpc`] and the header codec ([`Header`]);
//! - the calls of the slave API (`api::slave`) and the registrations (`registration`);
//! - the choice of publishers (`topic::sources`), the changes of the graph (`graph`), and names.
//!
//! Tasks run around them. One keeps the registrations in force (`registrar`). One runs for each
//! server (`api::server`, `tcpros::listener`). One runs for each subscription, and one for each of
//! its connections.
#![deny(unsafe_code)]
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod api;
mod config;
mod connections;
mod graph;
mod names;
mod node;
mod queue;
mod registrar;
mod registration;
mod service;
mod shared;
mod tcpros;
mod topic;
pub mod xmlrpc;

pub use api::RpcError;
pub use api::master::MasterError;
pub use config::NodeConfig;
pub use graph::{Change, Graph, Snapshot, Topic};
pub use names::NameError;
pub use node::{Node, NodeError, Publisher, ServiceServer, Subscription, TooLong};
pub use queue::QueueLimits;
pub use service::client::{CallError, ServiceClient, ServiceInfo};
pub use service::server::{ServiceRequest, ServiceType};
pub use shared::{MasterState, Status};
pub use tcpros::{Header, HeaderError};
pub use topic::publication::{MessageType, PublishOptions, Subscriber};
pub use topic::subscription::{Message, PublisherInfo, SourceState, SourceStates, SubscribeOptions};
