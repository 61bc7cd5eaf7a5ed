//! A message with the publisher it came from.

use bytes::Bytes;
use std::sync::Arc;

/// One message, and who published it.
#[derive(Clone, Debug)]
pub struct Message {
    /// As serialized by ROS 1, without the length in front.
    pub data: Bytes,
    pub publisher: Arc<PublisherInfo>,
}

/// What a publisher's connection header says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PublisherInfo {
    /// Of its slave API.
    pub uri: String,
    /// Its node's name; empty if it does not say.
    pub caller_id: String,
    /// Such as `std_msgs/String`.
    pub kind: String,
    pub md5sum: String,
    /// With those of all types in it; empty if it does not say.
    pub definition: String,
    /// The first message on each connection may be an old one.
    pub latching: bool,
}
