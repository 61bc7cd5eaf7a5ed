//! A ROS 1 node for bridges: it publishes, subscribes, serves and calls without knowing any type at
//! compile time.
//!
//! It is a node like those of roscpp and rospy: one name, one slave API (XML-RPC), one TCPROS port,
//! at one master. A process may have several, at several masters. What differs is that messages,
//! requests and responses are bytes, as ROS 1 serializes them, and that types are strings:
//!
//! - a [`Subscription`] asks publishers with `type=*` and `md5sum=*`, as `rostopic` does, and
//!   learns type, md5sum, message definition and whether it latches from the connection header of
//!   each ([`PublisherInfo`]). Each message says which publisher it is from, so a bridge can tell
//!   what another bridge has put there. What the node itself publishes never comes back.
//! - a [`Publisher`] is given its type ([`MessageType`]). With `latch`, everybody who connects
//!   later receives the last message.
//! - a [`ServiceServer`] calls a function with each request; a [`ServiceClient`] finds out the type
//!   of a service by a probe.
//! - a [`Graph`] watches the master for topics and services that come and go.
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
//! Nothing here waits for it. What is published, subscribed to and served is noted and registered
//! as soon as the master can be reached; [`Node::status`] says how that stands. Once each
//! [`NodeConfig::poll`] the node asks for the master's state, and registers again what is not in
//! it: so a master that was restarted knows the node again after one period. A subscription also
//! asks again when the state shows other publishers than before: a `publisherUpdate` that was lost
//! costs one period, and not the topic.
//!
//! Connections do not depend on the master. A restarted one lists only those publishers that
//! registered with it, and roscpp and rospy nodes register once; so a connection ends when its
//! publisher closes it, when it breaks, or when a master that has listed the publisher stops doing
//! so, but not because a new master never heard of it. While a publisher is listed, it is tried
//! again, after 200 ms and then ever more rarely, to once in 10 s ([`SourceState::Failed`] says
//! what is wrong).
//!
//! Of two nodes with one name the later has it, as everywhere in ROS 1. The earlier one shows
//! [`MasterState::NameTaken`] and waits until the name is free; it does not take it back.
//! `shutdown` (`rosnode kill`) is shown in [`Status::shutdown`] and nothing else: whether a bridge
//! ends because anybody in the network says so is its own decision.
//!
//! # Bounds
//!
//! ROS 1 authenticates nobody, so whoever reaches the ports of a node is believed as little as
//! possible. Memory for a message grows with the bytes that came, to [`NodeConfig::max_message`]; a
//! longer one ends its connection, and [`Subscription::sources`] says so. Whoever reads slowly has
//! a queue of [`QueueLimits`], and the oldest are dropped and counted. Headers, XML-RPC bodies,
//! their depth and number of values, connections, handshakes and all waiting are bounded as well;
//! the constants say where.
//!
//! # What is not here
//!
//! Parameters, UDPROS, `/rosout`, simulated time, remappings (their user applies them; names are
//! resolved and validated), and intraprocess shortcuts. `getBusStats` answers with empty lists.
//!
//! # How it is built
//!
//! Without I/O: [`xmlrpc`], the header codec ([`Header`]), the slave API's calls (`api::slave`),
//! what the master is to know (`registration`), whom to connect to (`topic::sources`), what has
//! changed (`graph`), names. Around these the tasks: one that keeps the master informed
//! (`registrar`), one for each server (`api::server`, `tcpros::listener`), one for each
//! subscription with one for each of its connections.
#![deny(unsafe_code)]
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod accept;
mod api;
mod config;
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
