//! A writer on behalf of a remote publisher.

use bytes::Bytes;
use gdp_ros::roster::{Kind, Offer};
use gdp_ros_zenoh::{RawPublisher, Topic, TypeHash};

use super::{ZenohGraph, view};
use crate::graph::event::{GraphError, WriteError};
use crate::ros2::{RawSample, RosError, TopicName, TypeName};

/// A writer on behalf of a remote publisher, which is one of that publisher's node.
pub struct ZenohWriter(RawPublisher);

impl ZenohGraph {
    /// Creates a writer of the proxy's own node. `hash` is that of the type.
    pub fn writer(
        &self,
        topic: &TopicName,
        kind: &Kind,
        hash: &[u8],
        offers: Offer,
    ) -> Result<ZenohWriter, GraphError> {
        let name = TypeName::parse(&kind.name).map_err(RosError::from)?;
        let topic = described(topic, &name, hash, &offers)?;
        Ok(ZenohWriter(RawPublisher::new(&self.node, topic, "")?))
    }
}

/// Describes a topic or service as a key and a token name it.
pub fn described(name: &TopicName, kind: &TypeName, hash: &[u8], offers: &Offer) -> Result<Topic, GraphError> {
    let hash = hash.try_into().map_err(|_| GraphError::NoHash(kind.to_string()))?;
    let qos = view::qos(offers);
    Ok(Topic { name: name.as_str().into(), kind: kind.to_dds(), hash: TypeHash(hash), qos })
}

impl ZenohWriter {
    /// Shows the writer as one of the node with this full name.
    pub fn assign(&self, node: &str) {
        if let Err(error) = self.0.assign(node) {
            tracing::debug!(node, "the publisher stays one of the proxy: {error}");
        }
    }

    pub fn is_matched(&self) -> bool {
        self.0.is_matched()
    }

    /// Writes one message with its source timestamp in Unix nanoseconds.
    pub async fn write(&self, bytes: Bytes, timestamp_ns: u64) -> Result<(), WriteError> {
        let sample = RawSample::parse(bytes).ok_or(WriteError::Malformed)?;
        let published = self.0.publish(sample.bytes, timestamp_ns).await;
        published.map_err(|error| WriteError::Failed(error.to_string()))
    }
}
