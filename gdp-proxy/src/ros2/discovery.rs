//! What other participants of the domain announce: the types of topics, and why an endpoint does not match ours.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use futures::StreamExt;
use rustdds::{
    DomainParticipant, DomainParticipantStatusEvent as Event, EndpointDescription, GUID, QosPolicies, RTPSEntity,
    StatusEvented,
};
use tokio::sync::Notify;

use super::{TopicName, TypeName};

#[derive(Default)]
pub(super) struct Discovery {
    /// The DDS types of the DDS topics that the proxy has endpoints for.
    expected: Mutex<HashMap<String, String>>,
    writer_appeared: Notify,
}

impl Discovery {
    /// Remembers which type a topic ought to have, so that it can be said when somebody's differs.
    pub fn expect(&self, topic: &TopicName, kind: &TypeName) {
        self.expected.lock().unwrap_or_else(PoisonError::into_inner).insert(topic.to_dds(), kind.to_dds());
    }

    /// Waits until somebody else publishes the topic with a type that ROS 2 made.
    pub async fn type_of(&self, participant: &DomainParticipant, topic: &TopicName) -> TypeName {
        let dds_topic = topic.to_dds();
        loop {
            let appeared = self.writer_appeared.notified();
            let writers = participant.discovered_writers();
            let foreign =
                writers.iter().filter(|w| w.writer_proxy.remote_writer_guid.prefix != participant.guid().prefix);
            let data = foreign.map(|w| &w.publication_topic_data).filter(|data| data.topic_name == dds_topic);
            for data in data {
                match TypeName::from_dds(&data.type_name) {
                    Ok(kind) => return kind,
                    Err(error) => tracing::warn!(%topic, "a publisher is ignored: {error}"),
                }
            }
            appeared.await;
        }
    }

    /// Follows what is discovered, for as long as the participant lives.
    pub async fn watch(self: Arc<Self>, participant: DomainParticipant) {
        let listener = participant.status_listener();
        let mut events = listener.as_async_status_stream();
        while let Some(event) = events.next().await {
            self.handle(&participant, event);
        }
    }

    fn handle(&self, participant: &DomainParticipant, event: Event) {
        match event {
            Event::WriterDetected { writer } => {
                self.compare("publisher", &writer);
                self.writer_appeared.notify_waiters();
            }
            Event::ReaderDetected { reader } => self.compare("subscriber", &reader),
            Event::RemoteWriterMatched { remote_writer, .. } if is_foreign(participant, remote_writer) => {
                tracing::info!(writer = ?remote_writer, "a ROS 2 publisher is heard");
            }
            Event::RemoteReaderMatched { remote_reader, .. } if is_foreign(participant, remote_reader) => {
                tracing::info!(reader = ?remote_reader, "a ROS 2 subscriber is served");
            }
            Event::RemoteWriterQosIncompatible { remote_writer, requested_qos, offered_qos, .. } => {
                let topic = participant
                    .discovered_writers()
                    .into_iter()
                    .find(|w| w.writer_proxy.remote_writer_guid == remote_writer)
                    .map(|w| w.publication_topic_data.topic_name);
                incompatible("publisher", topic, &requested_qos, &offered_qos);
            }
            Event::RemoteReaderQosIncompatible { remote_reader, requested_qos, offered_qos, .. } => {
                let topic = participant
                    .discovered_readers()
                    .into_iter()
                    .find(|r| r.reader_proxy.remote_reader_guid == remote_reader)
                    .map(|r| r.subscription_topic_data.topic_name().clone());
                incompatible("subscriber", topic, &requested_qos, &offered_qos);
            }
            _ => {}
        }
    }

    /// DDS does not match endpoints whose types differ, and says nothing.
    fn compare(&self, whose: &str, endpoint: &EndpointDescription) {
        let expected = self.expected.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kind) = expected.get(&endpoint.topic_name).filter(|kind| **kind != endpoint.type_name) {
            tracing::warn!(
                topic = endpoint.topic_name,
                "a {whose} here uses type {:?}, the proxy {kind}: they do not see each other; correct `type`",
                endpoint.type_name,
            );
        }
    }
}

fn is_foreign(participant: &DomainParticipant, endpoint: GUID) -> bool {
    endpoint.prefix != participant.guid().prefix
}

fn incompatible(whose: &str, topic: Option<String>, requested: &QosPolicies, offered: &QosPolicies) {
    let policy = offered.compliance_failure_wrt(requested);
    tracing::warn!(
        topic = topic.as_deref().unwrap_or("unknown"),
        "the QoS of a {whose} here does not fit the proxy's ({policy:?}): they do not see each other; correct `qos`",
    );
}
