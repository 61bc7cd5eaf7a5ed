//! The ROS 2 half of the proxy: a participant in a DDS domain, and readers and writers of topics of any type in it.
//!
//! The node, which is how ROS tools see the proxy, is ros2-client's; readers and writers of types unknown at compile time
//! are made on the RustDDS participant beneath it. Nothing here knows of the fabric; `route` joins the two.

mod discovery;
mod names;
mod qos;
mod raw;

pub use names::{NameError, TopicName, TypeName};
pub use qos::{Depth, Durability, Qos, Reliability};
pub use raw::{ENCAPSULATION, RawReader, RawSample, RawWriter, Representation, Unreadable, WriteError};

use std::sync::Arc;

use ros2_client::{Context, Node, NodeName, NodeOptions};
use rustdds::dds::CreateError;
use rustdds::{DomainParticipant, DomainParticipantBuilder, QosPolicies, TopicKind};
use tokio::task::JoinHandle;

use discovery::Discovery;

/// The largest domain id whose ports (7400 + 250 · id and up) exist.
pub const MAX_DOMAIN_ID: u16 = 232;

/// The proxy's presence in a DDS domain, until it [leaves](Domain::leave).
pub struct Domain {
    participant: DomainParticipant,
    publisher: rustdds::Publisher,
    subscriber: rustdds::Subscriber,
    discovery: Arc<Discovery>,
    /// Announces the proxy to ROS tools (`ros2 node list`) as long as it lives.
    node: Node,
    tasks: [JoinHandle<()>; 2],
}

/// What DDS refused to make.
#[derive(Debug, thiserror::Error)]
pub enum RosError {
    #[error(
        "cannot join DDS domain {domain}: {source}; is a network interface up (in a namespace: `ip link set lo up`), and is \
         the domain the one in ROS_DOMAIN_ID?"
    )]
    Join { domain: u16, source: CreateError },
    #[error("cannot announce the ROS node /{node}: {reason}")]
    Node { node: String, reason: String },
    #[error("cannot make a DDS {what} for {topic}: {source}")]
    Endpoint { what: &'static str, topic: TopicName, source: CreateError },
}

impl Domain {
    /// Joins a domain, at most [`MAX_DOMAIN_ID`], as the ROS node `node` in the root namespace. Needs a tokio runtime.
    pub fn join(domain: u16, node: &str) -> Result<Self, RosError> {
        let refused = |source| RosError::Join { domain, source };
        let participant = DomainParticipantBuilder::new(domain).build().map_err(refused)?;
        let none = QosPolicies::qos_none();
        let publisher = participant.create_publisher(&none).map_err(refused)?;
        let subscriber = participant.create_subscriber(&none).map_err(refused)?;
        let discovery = Arc::new(Discovery::default());
        let (node, spin) = announce(&participant, node)?;
        let watch = tokio::spawn(discovery.clone().watch(participant.clone()));
        Ok(Self { participant, publisher, subscriber, discovery, node, tasks: [watch, spin] })
    }

    /// The type of a topic, as soon as anyone else in the domain publishes it.
    pub async fn type_of(&self, topic: &TopicName) -> TypeName {
        self.discovery.type_of(&self.participant, topic).await
    }

    pub fn reader(&self, topic: &TopicName, kind: &TypeName, qos: Qos) -> Result<RawReader, RosError> {
        let refused = |source| RosError::Endpoint { what: "reader", topic: topic.clone(), source };
        let policies = qos.to_reader();
        let dds_topic = self.topic(topic, kind, &policies).map_err(refused)?;
        RawReader::new(&self.subscriber, &dds_topic, policies).map_err(refused)
    }

    pub fn writer(&self, topic: &TopicName, kind: &TypeName, qos: Qos) -> Result<RawWriter, RosError> {
        let refused = |source| RosError::Endpoint { what: "writer", topic: topic.clone(), source };
        let policies = qos.to_writer();
        let dds_topic = self.topic(topic, kind, &policies).map_err(refused)?;
        RawWriter::new(&self.publisher, &dds_topic, policies).map_err(refused)
    }

    fn topic(&self, topic: &TopicName, kind: &TypeName, qos: &QosPolicies) -> Result<rustdds::Topic, CreateError> {
        self.discovery.expect(topic, kind);
        self.participant.create_topic(topic.to_dds(), kind.to_dds(), qos, TopicKind::NoKey)
    }

    /// Says goodbye to the other participants, so that they do not wait for a lease to end. Readers and writers of the
    /// domain are of no use afterwards.
    pub async fn leave(self) {
        // The tasks hold the participant as well; RustDDS leaves when the last owner does, and joins its threads then.
        for task in self.tasks {
            task.abort();
            let _ = task.await;
        }
        let rest = (self.node, self.publisher, self.subscriber, self.participant);
        let _ = tokio::task::spawn_blocking(move || drop(rest)).await;
    }
}

fn announce(participant: &DomainParticipant, node: &str) -> Result<(Node, JoinHandle<()>), RosError> {
    let refused = |reason: String| RosError::Node { node: node.to_owned(), reason };
    let name = NodeName::new("/", node).map_err(|error| refused(error.to_string()))?;
    let context = Context::from_domain_participant(participant.clone()).map_err(|error| refused(error.to_string()))?;
    let options = NodeOptions::new().enable_rosout(false);
    let mut node = context.new_node(name, options).map_err(|error| refused(error.to_string()))?;
    let spinner = node.spinner().map_err(|error| refused(error.to_string()))?;
    let spin = tokio::spawn(async move {
        if let Err(error) = spinner.spin().await {
            tracing::warn!(%error, "ROS tools will not see this node");
        }
    });
    Ok((node, spin))
}
