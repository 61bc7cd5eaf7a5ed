//! Readers and writers of topics whose type is known by name only: a message is the bytes of its
//! CDR encapsulation, the four-byte header that says how it is encoded (RTPS 2.5 §10.2) and the
//! encoded body, carried as they are.

use std::collections::HashMap;
use std::convert::Infallible;
use std::future::poll_fn;
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use bytes::Bytes;
use futures::StreamExt;
use parking_lot::Mutex;
use rustdds::dds::adapters::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use rustdds::dds::{CreateError, ReadError};
use rustdds::no_key::{DataWriter, SimpleDataReader};
use rustdds::rpc::SampleIdentity;
use rustdds::{
    DataReaderStatus, DataWriterStatus, GUID, Publisher, QosPolicies, RTPSEntity, RepresentationIdentifier,
    SequenceNumber, StatusEvented, Timestamp, Topic, WriteOptions, WriteOptionsBuilder,
};
use tokio::task::coop::cooperative;

/// Bytes of the encapsulation header: representation (2), options (2).
pub const ENCAPSULATION: usize = 4;

/// How long a write may take, whatever RustDDS makes of the maximum blocking time: its own deadline
/// is only looked at when something else wakes the write.
const WRITE_DEADLINE: Duration = Duration::from_millis(100);

/// One message as it was on the wire.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawSample {
    pub representation: Representation,
    /// Encapsulation header and body. DDS vendors pad the body to a multiple of four.
    pub bytes: Bytes,
}

/// A message as it came from DDS.
pub struct Arrived {
    pub writer: GUID,
    pub sample: RawSample,
    /// When its writer wrote it, on the writer's clock, in nanoseconds since 1970.
    pub written_ns: Option<u64>,
    /// How many messages of the same writer were lost just before this one: on the way here, or
    /// because they came faster than they were taken.
    pub lost: u64,
}

/// A message with what services need to tell whose it is.
pub(super) struct SampleChange {
    pub sample: RawSample,
    pub writer: GUID,
    pub sequence: SequenceNumber,
    /// What the message answers, by its writer's word.
    pub related: Option<SampleIdentity>,
    written_ns: Option<u64>,
}

/// The encodings that ROS 2 uses: XCDR version 1, either byte order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Representation {
    CdrBe,
    CdrLe,
}

impl Representation {
    const fn header(self) -> [u8; ENCAPSULATION] {
        match self {
            Self::CdrBe => [0, 0, 0, 0],
            Self::CdrLe => [0, 1, 0, 0],
        }
    }
}

impl RawSample {
    /// Reads what another proxy sent; `None` if the bytes are not a CDR encapsulation that DDS
    /// could write.
    pub fn parse(bytes: Bytes) -> Option<Self> {
        let representation = match bytes.get(..ENCAPSULATION)? {
            [0, 0, ..] => Representation::CdrBe,
            [0, 1, ..] => Representation::CdrLe,
            _ => return None,
        };
        Some(Self { representation, bytes })
    }
}

/// A message arrived that this reader does not understand: not XCDR version 1. The text is for the
/// log.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Unreadable(String);

/// Reads a topic of any type. Messages that this participant itself wrote are not seen.
pub struct RawReader {
    reader: SimpleDataReader<RawSample, Adapter>,
    gaps: Mutex<Gaps>,
    /// As long as it is held, discovery says who uses another.
    _kind: Arc<str>,
}

/// Which message of each writer came last.
#[derive(Default)]
struct Gaps(HashMap<GUID, SequenceNumber>);

/// Writers whose gaps are counted. Beyond that all are forgotten, and the next gap of each is not
/// seen.
const MAX_WRITERS: usize = 4096;

impl Gaps {
    /// The messages between this one and the last of the same writer.
    fn before(&mut self, writer: GUID, sequence: SequenceNumber) -> u64 {
        if self.0.len() >= MAX_WRITERS && !self.0.contains_key(&writer) {
            self.0.clear();
        }
        let last = self.0.entry(writer).or_insert(sequence);
        let ahead = i64::from(sequence).saturating_sub(i64::from(*last));
        *last = sequence.max(*last);
        ahead.saturating_sub(1).try_into().unwrap_or(0)
    }
}

impl RawReader {
    /// `kind`: for discovery.
    pub(super) fn new(
        subscriber: &rustdds::Subscriber,
        topic: &Topic,
        kind: Arc<str>,
        qos: QosPolicies,
    ) -> Result<Self, CreateError> {
        let reader = subscriber.create_simple_datareader_no_key::<RawSample, Adapter>(topic, Some(qos))?;
        Ok(Self { reader, gaps: Mutex::default(), _kind: kind })
    }

    pub(super) fn guid(&self) -> GUID {
        self.reader.guid()
    }

    /// Waits until a writer of this participant is heard, which is told once.
    pub(super) async fn until_matched(&self, of: Participant) {
        let mut events = self.reader.as_async_status_stream();
        while let Some(event) = events.next().await {
            if matches!(event, DataReaderStatus::SubscriptionMatched { writer, current, .. }
                if participant(writer) == of && current.count_change() > 0)
            {
                return;
            }
        }
        std::future::pending().await
    }

    /// The next message. Wakes when it arrives, without polling; may be cancelled without losing
    /// one.
    pub async fn recv(&self) -> Result<Arrived, Unreadable> {
        let SampleChange { sample, writer, sequence, written_ns, .. } = self.change().await?;
        let lost = self.gaps.lock().before(writer, sequence);
        Ok(Arrived { writer, sample, written_ns, lost })
    }

    /// As [`recv`](Self::recv), with the message's identity.
    pub(super) async fn change(&self) -> Result<SampleChange, Unreadable> {
        // However much there is to read, others have their turn.
        cooperative(poll_fn(|context| {
            if let Some(taken) = self.take() {
                return Poll::Ready(taken);
            }
            self.reader.set_waker(Some(context.waker().clone()));
            // What came between the look and the waker would wake nobody.
            self.take().map_or(Poll::Pending, Poll::Ready)
        }))
        .await
    }

    fn take(&self) -> Option<Result<SampleChange, Unreadable>> {
        loop {
            match self.reader.try_take_one() {
                Ok(None) => return None,
                Ok(Some(change)) if self.is_own(change.writer_guid()) => {}
                Ok(Some(change)) => {
                    return Some(Ok(SampleChange {
                        writer: change.writer_guid(),
                        sequence: change.sequence_number,
                        related: change.related_sample_identity(),
                        written_ns: change.source_timestamp().map(nanoseconds),
                        sample: change.into_value(),
                    }));
                }
                Err(ReadError::UnknownKey { .. }) => {}
                Err(error) => return Some(Err(Unreadable(error.to_string()))),
            }
        }
    }

    /// What this participant wrote came from the fabric: taking it back would send it around for
    /// ever.
    fn is_own(&self, writer: GUID) -> bool {
        writer.prefix == self.reader.guid().prefix
    }
}

/// Writes a topic of any type.
pub struct RawWriter {
    little_endian: DataWriter<RawSample, Encoder<true>>,
    /// A DDS writer has one encoding; this one is made when the first message from a big-endian
    /// machine comes.
    big_endian: Option<DataWriter<RawSample, Encoder<false>>>,
    publisher: Publisher,
    topic: Topic,
    qos: QosPolicies,
    /// As long as it is held, discovery says who uses another.
    _kind: Arc<str>,
}

/// Why a message was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    #[error("the sockets of this host do not take messages as fast as they come")]
    Stalled,
    #[error("the DDS writer failed: {0}")]
    Failed(String),
}

impl RawWriter {
    /// `kind`: for discovery.
    pub(super) fn new(
        publisher: &Publisher,
        topic: &Topic,
        kind: Arc<str>,
        qos: QosPolicies,
    ) -> Result<Self, CreateError> {
        Ok(Self {
            little_endian: publisher.create_datawriter_no_key(topic, Some(qos.clone()))?,
            big_endian: None,
            publisher: publisher.clone(),
            topic: topic.clone(),
            qos,
            _kind: kind,
        })
    }

    /// Writes one message as of `timestamp_ns` (nanoseconds since 1970), which readers see as its
    /// source timestamp. Waits a bounded time for the sockets of this host.
    pub async fn write(&mut self, sample: RawSample, timestamp_ns: u64) -> Result<(), WriteError> {
        // A best-effort writer waits as well, rather than to throw away unseen what it has not sent
        // yet.
        let options = WriteOptionsBuilder::new().source_timestamp(timestamp(timestamp_ns)).best_effort_may_block(true);
        self.write_with(sample, options.build()).await.map(drop)
    }

    /// Writes one message, and says how others will name it.
    pub(super) async fn write_with(
        &mut self,
        sample: RawSample,
        options: WriteOptions,
    ) -> Result<SampleIdentity, WriteError> {
        let write = async {
            match sample.representation {
                Representation::CdrLe => self.little_endian.async_write_with_options(sample, options).await,
                Representation::CdrBe => self.big_endian()?.async_write_with_options(sample, options).await,
            }
            .map_err(|error| match error {
                rustdds::dds::WriteError::WouldBlock { .. } => WriteError::Stalled,
                other => WriteError::Failed(other.to_string()),
            })
        };
        let mut write = pin!(write);
        // Nearly always done at once; to set a timer would wake the runtime's thread for every
        // message.
        if let Poll::Ready(written) = poll_fn(|context| Poll::Ready(write.as_mut().poll(context))).await {
            return written;
        }
        tokio::time::timeout(WRITE_DEADLINE, write).await.unwrap_or(Err(WriteError::Stalled))
    }

    /// Whether it has matched a reader, since this was asked last.
    pub fn has_matched(&self) -> bool {
        let is_match =
            |status| matches!(status, DataWriterStatus::PublicationMatched { current, .. } if current.count() > 0);
        std::iter::from_fn(|| self.little_endian.try_recv_status()).any(is_match)
    }

    /// Waits until a reader is served that was not, or not any more: whose, and whether it is now.
    /// Each is told once.
    pub(super) async fn matching(&self) -> (GUID, bool) {
        let mut events = self.little_endian.as_async_status_stream();
        while let Some(event) = events.next().await {
            if let DataWriterStatus::PublicationMatched { reader, current, .. } = event {
                return (reader, current.count_change() > 0);
            }
        }
        std::future::pending().await
    }

    /// Waits until a reader of this participant is served, which is told once.
    pub(super) async fn until_matched(&self, of: Participant) {
        loop {
            if matches!(self.matching().await, (reader, true) if participant(reader) == of) {
                return;
            }
        }
    }

    /// Waits until reliable readers have what was written, for as long as that takes.
    pub async fn settle(&self) {
        // All that it fails with is that there is nothing to wait for any more.
        _ = self.little_endian.async_wait_for_acknowledgments().await;
        if let Some(writer) = &self.big_endian {
            _ = writer.async_wait_for_acknowledgments().await;
        }
    }

    /// Of the writer of little-endian messages.
    pub(super) fn guid(&self) -> GUID {
        self.little_endian.guid()
    }

    fn big_endian(&mut self) -> Result<&DataWriter<RawSample, Encoder<false>>, WriteError> {
        let writer = match self.big_endian.take() {
            Some(writer) => writer,
            None => self
                .publisher
                .create_datawriter_no_key(&self.topic, Some(self.qos.clone()))
                .map_err(|error| WriteError::Failed(error.to_string()))?,
        };
        Ok(self.big_endian.insert(writer))
    }
}

/// What the GUIDs of all endpoints of a participant begin with.
pub(super) type Participant = [u8; 12];

/// Whose endpoint it is.
pub(super) fn participant(endpoint: GUID) -> Participant {
    let bytes = endpoint.to_bytes();
    std::array::from_fn(|i| bytes[i])
}

/// RTPS time is seconds and 2⁻³² fractions of a second since 1970, until 2106.
fn timestamp(ns: u64) -> Timestamp {
    let (seconds, nanos) = (ns / 1_000_000_000, ns % 1_000_000_000);
    match u32::try_from(seconds) {
        Ok(seconds) => Timestamp::from_ticks((u64::from(seconds) << 32) + (nanos << 32) / 1_000_000_000),
        Err(_) => Timestamp::now(),
    }
}

fn nanoseconds(timestamp: Timestamp) -> u64 {
    let ticks = timestamp.to_ticks();
    (ticks >> 32) * 1_000_000_000 + (((ticks & 0xffff_ffff) * 1_000_000_000) >> 32)
}

/// Takes bytes out of RustDDS, which hands them over without their encapsulation header.
struct Adapter;

#[derive(Clone)]
struct Decoder;

impl DeserializerAdapter<RawSample> for Adapter {
    type Error = Infallible;
    type Decoded = RawSample;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE, RepresentationIdentifier::CDR_BE]
    }

    fn transform_decoded(decoded: RawSample) -> RawSample {
        decoded
    }
}

impl DefaultDecoder<RawSample> for Adapter {
    type Decoder = Decoder;
    const DECODER: Decoder = Decoder;
}

impl Decode<'_, RawSample> for Decoder {
    type Error = Infallible;

    fn decode_bytes(self, body: &[u8], encoding: RepresentationIdentifier) -> Result<RawSample, Infallible> {
        let representation = match encoding {
            RepresentationIdentifier::CDR_BE => Representation::CdrBe,
            _ => Representation::CdrLe,
        };
        let mut bytes = Vec::with_capacity(ENCAPSULATION + body.len());
        bytes.extend(representation.header());
        bytes.extend(body);
        Ok(RawSample { representation, bytes: bytes.into() })
    }
}

/// Gives bytes to RustDDS, which writes the encapsulation header itself, from the type of the
/// writer.
struct Encoder<const LITTLE_ENDIAN: bool>;

impl<const LITTLE_ENDIAN: bool> SerializerAdapter<RawSample> for Encoder<LITTLE_ENDIAN> {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        match LITTLE_ENDIAN {
            true => RepresentationIdentifier::CDR_LE,
            false => RepresentationIdentifier::CDR_BE,
        }
    }

    fn to_bytes(sample: &RawSample) -> Result<Bytes, Infallible> {
        Ok(sample.bytes.slice(ENCAPSULATION..))
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/raw.rs"]
mod tests;
