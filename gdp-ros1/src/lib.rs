//! A ROS 1 node for bridges.
#![deny(unsafe_code)]

mod accept;
mod api;
mod backoff;
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
