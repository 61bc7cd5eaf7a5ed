//! Writers of topics whose type is known by name only. A message is its CDR encapsulation, carried
//! unchanged: a four-byte header with the encoding (RTPS 2.5 §10.2), and the encoded body.

use std::future::poll_fn;
use std::pin::pin;
use std::sync::{Arc, Weak};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use futures::StreamExt;
use rustdds::dds::CreateError;
use rustdds::no_key::DataWriter;
use rustdds::policy::Liveliness;
use rustdds::rpc::SampleIdentity;
use rustdds::{
    DataWriterStatus, GUID, Publisher, QosPolicies, RTPSEntity, StatusEvented, Timestamp, Topic, WriteOptions,
    WriteOptionsBuilder,
};
use tokio::task::JoinHandle;
use tokio::time::MissedTickBehavior;

use super::nodes::{NodeEntry, Nodes};
use super::qos;
use super::sample::{Encoder, RawSample, Representation};

/// Timeout of a write. RustDDS checks its own maximum blocking time only when something else wakes
/// the write.
const WRITE_DEADLINE: Duration = Duration::from_millis(100);

/// A writer of a topic of any type.
pub struct RawWriter {
    little_endian: EncodedWriter<true>,
    /// A DDS writer has one encoding. This writer is created with the first big-endian message.
    big_endian: Option<EncodedWriter<false>>,
    publisher: Publisher,
    topic: Topic,
    qos: QosPolicies,
    nodes: Arc<Nodes>,
    /// The full name of the ROS node, or `None` for that of the proxy.
    node: Option<String>,
    /// The depth of the history, if it was changed.
    depth: Option<usize>,
    /// Registers the expected type at discovery, so that different types of others are logged.
    _kind: Arc<str>,
}

/// A DDS writer of one encoding.
struct EncodedWriter<const LITTLE_ENDIAN: bool> {
    writer: Arc<DataWriter<RawSample, Encoder<LITTLE_ENDIAN>>>,
    node: NodeEntry,
    /// Asserts the liveliness of a writer with manual liveliness.
    assertions: Option<JoinHandle<()>>,
}

/// Writes messages of a [`RawWriter`] from any thread, at once or not at all.
#[derive(Clone)]
pub struct ImmediateWriter(Arc<DataWriter<RawSample, Encoder<true>>>);

impl ImmediateWriter {
    /// Writes a little-endian message as [`RawWriter::write`] does. Returns false if it was not
    /// taken.
    pub fn write(&self, sample: &RawSample, timestamp_ns: u64) -> bool {
        if sample.representation != Representation::CdrLe {
            return false;
        }
        let write = self.0.async_write_with_options(sample.clone(), options(timestamp_ns));
        // DDS sends it within this call, unless something is queued.
        matches!(pin!(write).poll(&mut Context::from_waker(Waker::noop())), Poll::Ready(Ok(_)))
    }
}

/// Reasons for which a message was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    #[error("the sockets of this host do not take messages as fast as they come")]
    Stalled,
    #[error("the DDS writer failed: {0}")]
    Failed(String),
}

impl RawWriter {
    /// `kind` is registered at discovery.
    pub(super) fn new(
        publisher: &Publisher,
        topic: &Topic,
        kind: Arc<str>,
        qos: QosPolicies,
        nodes: &Arc<Nodes>,
    ) -> Result<Self, CreateError> {
        Ok(Self {
            little_endian: EncodedWriter::new(publisher, topic, &qos, nodes)?,
            big_endian: None,
            publisher: publisher.clone(),
            topic: topic.clone(),
            qos,
            nodes: nodes.clone(),
            node: None,
            depth: None,
            _kind: kind,
        })
    }

    /// Moves the writer to the ROS node with this full name, which may be a remote one.
    pub fn assign(&mut self, node: &str) {
        self.little_endian.node.assign(node);
        if let Some(writer) = &self.big_endian {
            writer.node.assign(node);
        }
        self.node = Some(node.to_owned());
    }

    /// Changes the depth of the history: 0 keeps as much as
    /// [`Depth::MAX`](super::Depth::MAX) allows.
    pub fn set_depth(&mut self, depth: u32) {
        let depth = qos::depth(depth);
        self.depth = Some(depth);
        self.little_endian.writer.set_history_depth(depth);
        if let Some(writer) = &self.big_endian {
            writer.writer.set_history_depth(depth);
        }
    }

    /// Writes one message with the source timestamp `timestamp_ns`, in Unix nanoseconds. It waits a
    /// bounded time for the sockets of this host.
    pub async fn write(&mut self, sample: RawSample, timestamp_ns: u64) -> Result<(), WriteError> {
        self.write_with(sample, options(timestamp_ns)).await.map(drop)
    }

    /// Returns a writer of little-endian messages for other threads.
    pub fn immediate_writer(&self) -> ImmediateWriter {
        ImmediateWriter(self.little_endian.writer.clone())
    }

    /// Writes one message, and returns the identity by which replies refer to it.
    pub(super) async fn write_with(
        &mut self,
        sample: RawSample,
        options: WriteOptions,
    ) -> Result<SampleIdentity, WriteError> {
        let write = async {
            match sample.representation {
                Representation::CdrLe => self.little_endian.writer.async_write_with_options(sample, options).await,
                Representation::CdrBe => self.big_endian()?.async_write_with_options(sample, options).await,
            }
            .map_err(|error| match error {
                rustdds::dds::WriteError::WouldBlock { .. } => WriteError::Stalled,
                other => WriteError::Failed(other.to_string()),
            })
        };
        let mut write = pin!(write);
        // A write nearly always completes at once. A timer would wake the runtime's thread for
        // every message.
        if let Poll::Ready(written) = poll_fn(|context| Poll::Ready(write.as_mut().poll(context))).await {
            return written;
        }
        tokio::time::timeout(WRITE_DEADLINE, write).await.unwrap_or(Err(WriteError::Stalled))
    }

    /// Whether a reader has matched since the last call.
    pub fn has_matched(&self) -> bool {
        let is_match =
            |status| matches!(status, DataWriterStatus::PublicationMatched { current, .. } if current.count() > 0);
        std::iter::from_fn(|| self.little_endian.writer.try_recv_status()).any(is_match)
    }

    /// Waits until a reader is matched or unmatched. Returns the reader, and whether it is matched
    /// now. Each change is reported once.
    pub(super) async fn matching(&self) -> (GUID, bool) {
        let mut events = self.little_endian.writer.as_async_status_stream();
        while let Some(event) = events.next().await {
            if let DataWriterStatus::PublicationMatched { reader, current, .. } = event {
                return (reader, current.count_change() > 0);
            }
        }
        std::future::pending().await
    }

    /// Waits until a reader of this participant is matched. Each match is reported once.
    pub(super) async fn until_matched(&self, of: Participant) {
        loop {
            if matches!(self.matching().await, (reader, true) if participant(reader) == of) {
                return;
            }
        }
    }

    /// Waits without a timeout until reliable readers have acknowledged all messages.
    pub async fn settle(&self) {
        // An error only means that there is nothing to wait for.
        _ = self.little_endian.writer.async_wait_for_acknowledgments().await;
        if let Some(writer) = &self.big_endian {
            _ = writer.writer.async_wait_for_acknowledgments().await;
        }
    }

    /// Returns the GUID of the little-endian writer.
    pub(super) fn guid(&self) -> GUID {
        self.little_endian.writer.guid()
    }

    fn big_endian(&mut self) -> Result<&DataWriter<RawSample, Encoder<false>>, WriteError> {
        let writer = match self.big_endian.take() {
            Some(writer) => writer,
            None => {
                let writer = EncodedWriter::new(&self.publisher, &self.topic, &self.qos, &self.nodes)
                    .map_err(|error| WriteError::Failed(error.to_string()))?;
                self.node.iter().for_each(|node| writer.node.assign(node));
                self.depth.iter().for_each(|depth| writer.writer.set_history_depth(*depth));
                writer
            }
        };
        Ok(&self.big_endian.insert(writer).writer)
    }
}

impl<const LITTLE_ENDIAN: bool> EncodedWriter<LITTLE_ENDIAN> {
    fn new(publisher: &Publisher, topic: &Topic, qos: &QosPolicies, nodes: &Arc<Nodes>) -> Result<Self, CreateError> {
        let writer = Arc::new(publisher.create_datawriter_no_key(topic, Some(qos.clone()))?);
        let node = nodes.add(writer.guid());
        let assertions = match qos.liveliness() {
            Some(Liveliness::ManualByTopic { lease_duration }) => {
                Some(tokio::spawn(assert_liveliness(Arc::downgrade(&writer), lease_duration.to_std() / 3)))
            }
            _ => None,
        };
        Ok(Self { writer, node, assertions })
    }
}

impl<const LITTLE_ENDIAN: bool> Drop for EncodedWriter<LITTLE_ENDIAN> {
    fn drop(&mut self) {
        if let Some(assertions) = &self.assertions {
            assertions.abort();
        }
    }
}

/// Asserts the liveliness of a writer for as long as it exists. Its remote publisher is alive until
/// then.
async fn assert_liveliness<const LITTLE_ENDIAN: bool>(
    writer: Weak<DataWriter<RawSample, Encoder<LITTLE_ENDIAN>>>,
    period: Duration,
) {
    let mut ticks = tokio::time::interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let Some(writer) = writer.upgrade() else { return };
        // It fails while discovery is busy. The next assertion follows.
        _ = writer.assert_liveliness();
    }
}

/// The GUID prefix of all endpoints of a participant.
pub(super) type Participant = [u8; 12];

/// Returns the participant of an endpoint.
pub(super) fn participant(endpoint: GUID) -> Participant {
    let bytes = endpoint.to_bytes();
    std::array::from_fn(|i| bytes[i])
}

fn options(timestamp_ns: u64) -> WriteOptions {
    // A best-effort writer waits as well. Otherwise it would silently discard messages that it has
    // not sent yet.
    WriteOptionsBuilder::new().source_timestamp(timestamp(timestamp_ns)).best_effort_may_block(true).build()
}

/// Converts Unix nanoseconds to RTPS time: seconds and 2⁻³² fractions of a second since 1970, until
/// 2106.
fn timestamp(ns: u64) -> Timestamp {
    let (seconds, nanos) = (ns / 1_000_000_000, ns % 1_000_000_000);
    match u32::try_from(seconds) {
        Ok(seconds) => Timestamp::from_ticks((u64::from(seconds) << 32) + (nanos << 32) / 1_000_000_000),
        Err(_) => Timestamp::now(),
    }
}

pub(super) fn nanoseconds(timestamp: Timestamp) -> u64 {
    let ticks = timestamp.to_ticks();
    (ticks >> 32) * 1_000_000_000 + (((ticks & 0xffff_ffff) * 1_000_000_000) >> 32)
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/raw.rs"]
mod tests;
