//! What other participants of the domain announce: the types of topics, and why an endpoint does not match ours.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use futures::{FutureExt, StreamExt};
use rustdds::{
    DomainParticipant, DomainParticipantStatusEvent as Event, EndpointDescription, GUID, QosPolicies, RTPSEntity,
    StatusEvented,
};
use tokio::sync::watch;

use super::qos::offered;
use super::{TopicName, TypeName};
use crate::graph::Key;
use crate::roster::{Dialect, Kind, Offer};

#[derive(Default)]
pub(super) struct Discovery {
    /// The DDS types of the DDS topics that the proxy has endpoints for.
    expected: Mutex<HashMap<String, String>>,
    publishers: watch::Sender<Publishers>,
    /// Of types that are not of ROS 2, which has been said.
    odd: Mutex<HashSet<GUID>>,
}

pub(crate) type Publishers = Arc<HashMap<String, Vec<Publisher>>>;

/// A publisher of a topic, in another participant.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Publisher {
    pub key: Key,
    pub kind: Kind,
    pub offers: Offer,
}

impl Discovery {
    /// Remembers which type a topic ought to have, so that it can be said when somebody's differs.
    pub fn expect(&self, topic: &TopicName, kind: &TypeName) {
        self.expected.lock().unwrap_or_else(PoisonError::into_inner).insert(topic.to_dds(), kind.to_dds());
    }

    /// The publishers of the topics of the domain, by DDS topic; always the newest.
    pub fn publishers(&self) -> watch::Receiver<Publishers> {
        self.publishers.subscribe()
    }

    /// Follows what is discovered, for as long as the participant lives. A participant has one queue of events: whoever
    /// else read it would take some of them away.
    pub async fn watch(self: Arc<Self>, participant: DomainParticipant) {
        let listener = participant.status_listener();
        let mut events = listener.as_async_status_stream();
        while let Some(event) = events.next().await {
            self.handle(&participant, event);
            while let Some(Some(event)) = events.next().now_or_never() {
                self.handle(&participant, event);
            }
            // Whatever it was: the queue is short, and an event may have found it full.
            let now = self.list(&participant);
            self.publishers.send_if_modified(|before| {
                let differs = *before != now;
                *before = now;
                differs
            });
        }
    }

    fn list(&self, participant: &DomainParticipant) -> Publishers {
        let mut publishers = HashMap::<String, Vec<Publisher>>::new();
        for writer in participant.discovered_writers() {
            let (data, guid) = (&writer.publication_topic_data, writer.writer_proxy.remote_writer_guid);
            if !is_application(participant, guid) || !data.topic_name.starts_with("rt/") {
                continue;
            }
            let kind = match TypeName::from_dds(&data.type_name) {
                Ok(kind) => kind,
                Err(error) => {
                    if self.lock_odd().insert(guid) {
                        tracing::warn!(topic = data.topic_name, "a publisher is ignored: {error}");
                    }
                    continue;
                }
            };
            let hash = type_hash(&writer.user_data).unwrap_or_default();
            let kind = Kind { dialect: Dialect::Ros2, name: kind.to_string(), hash };
            let found = Publisher { key: u128::from_be_bytes(guid.to_bytes()), kind, offers: offered(data) };
            publishers.entry(data.topic_name.clone()).or_default().push(found);
        }
        publishers.values_mut().for_each(|found| found.sort_by_key(|publisher| publisher.key));
        publishers.into()
    }

    fn lock_odd(&self) -> MutexGuard<'_, HashSet<GUID>> {
        self.odd.lock().unwrap_or_else(PoisonError::into_inner)
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

/// What a participant of ROS 2 Iron or later says of its type: `typehash=RIHS01_…;`, with hexadecimal digits.
fn type_hash(user_data: &[u8]) -> Option<Vec<u8>> {
    const KEY: &[u8] = b"typehash=RIHS01_";
    let at = user_data.windows(KEY.len()).position(|window| window == KEY)? + KEY.len();
    hex::decode(user_data.get(at..at + 64)?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn type_hashes_are_found_behind_whatever_is_said_before() {
        let hash = "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let said = format!("\x50\0\0\0enclave=/;typehash=RIHS01_{hash};");
        assert_eq!(type_hash(said.as_bytes()).map(hex::encode).as_deref(), Some(hash));
        for odd in ["", "typehash=RIHS01_", "typehash=RIHS01_df66", &said.replace("RIHS01", "RIHS02"), &said.replace("df", "xx")] {
            assert_eq!(type_hash(odd.as_bytes()), None, "{odd}");
        }
    }
}
