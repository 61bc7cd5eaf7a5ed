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
    something_happened: Notify,
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
            let news = self.something_happened.notified();
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
            news.await;
        }
    }

    /// Follows what is discovered, for as long as the participant lives. A participant has one queue of events: whoever
    /// else read it would take some of them away.
    pub async fn watch(self: Arc<Self>, participant: DomainParticipant) {
        let listener = participant.status_listener();
        let mut events = listener.as_async_status_stream();
        while let Some(event) = events.next().await {
            self.handle(&participant, event);
            // Whatever it was: the queue is short, and the event that somebody waits for may have found it full.
            self.something_happened.notify_waiters();
        }
    }

    fn handle(&self, participant: &DomainParticipant, event: Event) {
        match event {
            Event::WriterDetected { writer } => self.compare("publisher", &writer),
            Event::ReaderDetected { reader } => self.compare("subscriber", &reader),
            Event::RemoteWriterMatched { remote_writer, .. } if is_application(participant, remote_writer) => {
                let topic = written_topic(participant, remote_writer);
                tracing::info!(topic, writer = ?remote_writer, "a local publisher is heard");
            }
            Event::RemoteReaderMatched { remote_reader, .. } if is_application(participant, remote_reader) => {
                let topic = read_topic(participant, remote_reader);
                tracing::info!(topic, reader = ?remote_reader, "a local subscriber is served");
            }
            Event::RemoteWriterQosIncompatible { remote_writer, requested_qos, offered_qos, .. } => {
                incompatible("publisher", written_topic(participant, remote_writer), &requested_qos, &offered_qos);
            }
            Event::RemoteReaderQosIncompatible { remote_reader, requested_qos, offered_qos, .. } => {
                incompatible("subscriber", read_topic(participant, remote_reader), &requested_qos, &offered_qos);
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

/// Not one of ours, and not one of those that discovery itself uses.
fn is_application(participant: &DomainParticipant, endpoint: GUID) -> bool {
    endpoint.prefix != participant.guid().prefix && endpoint.entity_id.kind().is_user_defined()
}

fn written_topic(participant: &DomainParticipant, writer: GUID) -> Option<String> {
    let mut writers = participant.discovered_writers().into_iter();
    let found = writers.find(|found| found.writer_proxy.remote_writer_guid == writer)?;
    Some(found.publication_topic_data.topic_name)
}

fn read_topic(participant: &DomainParticipant, reader: GUID) -> Option<String> {
    let mut readers = participant.discovered_readers().into_iter();
    let found = readers.find(|found| found.reader_proxy.remote_reader_guid == reader)?;
    Some(found.subscription_topic_data.topic_name().clone())
}

fn incompatible(whose: &str, topic: Option<String>, requested: &QosPolicies, offered: &QosPolicies) {
    let policy = offered.compliance_failure_wrt(requested);
    tracing::warn!(
        topic,
        "the QoS of a {whose} here does not fit the proxy's ({policy:?}): they do not see each other; correct `qos`",
    );
}
