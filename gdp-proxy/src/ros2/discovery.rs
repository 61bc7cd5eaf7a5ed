//! Reads what other participants of the domain announce: the types of topics, and why an endpoint
//! does not match ours.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Weak};
use std::time::Duration;

use futures::StreamExt;
use parking_lot::Mutex;
use rustdds::{
    DomainParticipant, DomainParticipantStatusEvent as Event, EndpointDescription, GUID, QosPolicies, RTPSEntity,
    StatusEvented,
};
use tokio::sync::watch;

use super::graph::{Graph, Seen};
use super::nodes::Nodes;
use super::{TypeName, raw};

/// Time for which events are gathered before the graph is built again. A new node announces a dozen
/// endpoints.
const GATHER: Duration = Duration::from_millis(20);

/// Period in which the graph is built without events. The queue of events is short, and may have
/// been full.
const LOOK: Duration = Duration::from_secs(1);

#[derive(Default)]
pub(super) struct Discovery {
    /// The DDS types of the DDS topics for which the proxy has endpoints. The endpoints hold them.
    expected: Mutex<HashMap<String, Weak<str>>>,
    graph: watch::Sender<Arc<Graph>>,
    writers: watch::Sender<Arc<Writers>>,
}

/// The writers of all other participants.
pub(super) type Writers = HashSet<GUID>;

impl Discovery {
    /// Registers the expected type of a topic, so that different types of others are logged. The
    /// registration ends when the returned value is dropped.
    pub fn expect(&self, dds_topic: &str, kind: &TypeName) -> Arc<str> {
        let mut expected = self.expected.lock();
        expected.retain(|_, kind| kind.strong_count() > 0);
        let kind: Arc<str> = kind.to_dds().into();
        let known = expected.get(dds_topic).and_then(Weak::upgrade).filter(|known| *known == kind);
        let kind = known.unwrap_or(kind);
        expected.insert(dds_topic.to_owned(), Arc::downgrade(&kind));
        kind
    }

    pub fn graph(&self) -> watch::Receiver<Arc<Graph>> {
        self.graph.subscribe()
    }

    pub fn writers(&self) -> watch::Receiver<Arc<Writers>> {
        self.writers.subscribe()
    }

    /// Follows discovery for as long as the participant exists. A participant has one queue of
    /// events, so nobody else may read it.
    pub async fn watch(self: Arc<Self>, participant: DomainParticipant, nodes: Arc<Nodes>) {
        let mut names = nodes.remote();
        let listener = participant.status_listener();
        let mut events = listener.as_async_status_stream();
        let mut due = tokio::time::Instant::now();
        loop {
            tokio::select! {
                event = events.next() => {
                    let Some(event) = event else { return };
                    self.handle(&participant, event);
                    due = due.min(tokio::time::Instant::now() + GATHER);
                }
                changed = names.changed() => {
                    if changed.is_err() {
                        return;
                    }
                    due = due.min(tokio::time::Instant::now() + GATHER);
                }
                () = tokio::time::sleep_until(due) => {
                    due = gdp_util::ticks::next_tick(LOOK, std::time::Instant::now()).into();
                    self.look(&participant, &nodes);
                }
            }
        }
    }

    fn look(&self, participant: &DomainParticipant, nodes: &Nodes) {
        let own = participant.guid().prefix;
        let writers = participant.discovered_writers().into_iter().map(|writer| {
            let (data, guid) = (writer.publication_topic_data, writer.writer_proxy.remote_writer_guid);
            let qos = data.qos();
            Seen { guid, writes: true, topic: data.topic_name, kind: data.type_name, qos, user_data: writer.user_data }
        });
        let readers = participant.discovered_readers().into_iter().map(|reader| {
            let (data, guid) = (reader.subscription_topic_data, reader.reader_proxy.remote_reader_guid);
            let (topic, kind, qos) = (data.topic_name().clone(), data.type_name().clone(), data.qos());
            Seen { guid, writes: false, topic, kind, qos, user_data: reader.user_data }
        });
        let seen: Vec<Seen> = writers.chain(readers).filter(|seen| seen.guid.prefix != own).collect();
        nodes.retain(&seen.iter().map(|seen| raw::participant(seen.guid)).collect());
        replace(&self.writers, seen.iter().filter(|seen| seen.writes).map(|seen| seen.guid).collect());
        replace(&self.graph, Graph::new(seen.into_iter(), &nodes.remote().borrow()));
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

    /// Logs an endpoint of another type. DDS does not match it, and reports nothing.
    fn compare(&self, whose: &str, endpoint: &EndpointDescription) {
        let expected = self.expected.lock();
        let kind = expected.get(&endpoint.topic_name).and_then(Weak::upgrade);
        if let Some(kind) = kind.filter(|kind| **kind != *endpoint.type_name) {
            tracing::warn!(
                topic = endpoint.topic_name,
                "a {whose} here uses type {:?}, the proxy {kind}: they do not see each other; correct `type`",
                endpoint.type_name,
            );
        }
    }
}

/// Publishes the value only if it has changed.
fn replace<T: PartialEq>(shown: &watch::Sender<Arc<T>>, now: T) {
    shown.send_if_modified(|before| {
        let is_news = **before != now;
        if is_news {
            *before = Arc::new(now);
        }
        is_news
    });
}

/// Whether the endpoint is another participant's, and not one of discovery itself.
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

#[cfg(test)]
#[path = "../../tests/unit/ros2/discovery.rs"]
mod tests;
