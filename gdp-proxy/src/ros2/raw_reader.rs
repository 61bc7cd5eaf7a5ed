//! Readers of topics whose type is known by name only. A message is its CDR encapsulation, carried
//! unchanged, as a [writer](super::raw) writes it.
//!
//! A sink may take messages on DDS's receiving thread, without the wake-up of a task. It overtakes
//! nothing: it is asked only while the task waits for the next message and has processed all that
//! it took.

use std::future::poll_fn;
use std::sync::{Arc, Weak};
use std::task::{Context, Poll, Wake, Waker};

use futures::StreamExt;
use parking_lot::Mutex;
use rustdds::dds::{CreateError, ReadError};
use rustdds::no_key::SimpleDataReader;
use rustdds::rpc::SampleIdentity;
use rustdds::{DataReaderStatus, GUID, QosPolicies, SequenceNumber, StatusEvented, Topic};
use tokio::task::coop::cooperative;

use super::gaps::Gaps;
use super::nodes::{NodeEntry, Nodes};
use super::raw::{Participant, nanoseconds, participant};
use super::sample::{Adapter, RawSample};

/// A message that DDS delivered.
pub struct Arrived {
    pub writer: GUID,
    pub sample: RawSample,
    /// Time of the write on the writer's clock, in Unix nanoseconds.
    pub written_ns: Option<u64>,
    /// Number of messages of the same writer that were lost just before this one: in transit, or
    /// because they came faster than they were read.
    pub lost: u64,
}

/// A change of a matched writer, with its GUID.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WriterChange {
    /// Whether the writer is alive now.
    Liveliness([u8; 16], bool),
    /// Number of messages that a transient-local writer keeps for late joiners. It has grown.
    History([u8; 16], usize),
}

/// A message with the identity that services need.
pub(super) struct SampleChange {
    pub sample: RawSample,
    pub writer: GUID,
    pub sequence: SequenceNumber,
    /// The identity of the request that the message answers, as its writer announces it.
    pub related: Option<SampleIdentity>,
    written_ns: Option<u64>,
}

/// A message that is not in XCDR version 1. The text is for the log.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Unreadable(String);

/// Takes a message on DDS's receiving thread and returns true, or leaves it to the task.
///
/// That thread receives nothing meanwhile, so the sink must return soon. It must not use the
/// reader, whose lock is held.
pub type SampleSink = Box<dyn FnMut(&Arrived) -> bool + Send>;

/// A reader of a topic of any type. It ignores messages that this participant itself wrote.
pub struct RawReader {
    shared: Arc<SharedReader>,
    /// Registers the expected type at discovery, so that different types of others are logged.
    _kind: Arc<str>,
    node: NodeEntry,
}

/// What DDS's receiving thread uses as well.
struct SharedReader {
    reader: SimpleDataReader<RawSample, Adapter>,
    /// DDS calls it for new messages.
    on_data: Waker,
    state: Mutex<ReaderState>,
}

#[derive(Default)]
struct ReaderState {
    gaps: Gaps,
    sink: Option<SampleSink>,
    /// Whether the task waits for a message.
    is_waiting: bool,
    task: Option<Waker>,
    /// The message that the sink has left to the task.
    left: Option<Result<Arrived, Unreadable>>,
}

impl RawReader {
    /// `kind` is registered at discovery.
    pub(super) fn new(
        subscriber: &rustdds::Subscriber,
        topic: &Topic,
        kind: Arc<str>,
        qos: QosPolicies,
        nodes: &Arc<Nodes>,
    ) -> Result<Self, CreateError> {
        let reader = subscriber.create_simple_datareader_no_key::<RawSample, Adapter>(topic, Some(qos))?;
        let node = nodes.add(reader.guid());
        let shared = Arc::new_cyclic(|shared: &Weak<SharedReader>| SharedReader {
            reader,
            on_data: Arc::new(OnData(shared.clone())).into(),
            state: Mutex::default(),
        });
        Ok(Self { shared, _kind: kind, node })
    }

    pub(super) fn guid(&self) -> GUID {
        self.shared.reader.guid()
    }

    /// Moves the reader to the ROS node with this full name, which may be a remote one.
    pub fn assign(&self, node: &str) {
        self.node.assign(node);
    }

    /// Waits until a writer of the participant of this endpoint matches. Each match is reported
    /// once.
    pub async fn until_matched(&self, endpoint: [u8; 16]) {
        let of: Participant = std::array::from_fn(|i| endpoint[i]);
        let mut events = self.shared.reader.as_async_status_stream();
        while let Some(event) = events.next().await {
            if matches!(event, DataReaderStatus::SubscriptionMatched { writer, current, .. }
                if participant(writer) == of && current.count_change() > 0)
            {
                return;
            }
        }
        std::future::pending().await
    }

    /// Waits for a change of a matched writer. Each change is reported once. It also discards all
    /// other changes of the status.
    pub async fn writer_change(&self) -> WriterChange {
        let mut events = self.shared.reader.as_async_status_stream();
        while let Some(event) = events.next().await {
            match event {
                DataReaderStatus::LivelinessChanged { alive_total, writer, .. } => {
                    return WriterChange::Liveliness(writer.to_bytes(), alive_total.count_change() > 0);
                }
                DataReaderStatus::WriterHistoryGrown { writer, samples } => {
                    return WriterChange::History(writer.to_bytes(), samples);
                }
                _ => {}
            }
        }
        std::future::pending().await
    }

    /// Sets the sink of messages. It is not asked before [`Self::recv`] waits again.
    pub fn set_sink(&self, sink: Option<SampleSink>) {
        let mut state = self.shared.state.lock();
        state.is_waiting = false;
        let before = std::mem::replace(&mut state.sink, sink);
        drop(state);
        drop(before);
    }

    /// Leaves all messages to the task until [`Self::recv`] waits again.
    pub fn suspend_sink(&self) {
        self.shared.state.lock().is_waiting = false;
    }

    /// Waits for the next message, without polling. A cancelled call loses no message.
    pub async fn recv(&self) -> Result<Arrived, Unreadable> {
        // Other tasks get their turn, however much there is to read.
        cooperative(poll_fn(|context| self.shared.poll(context, SharedReader::next))).await
    }

    /// Waits for the next message as [`recv`](Self::recv), and returns it with its identity. Only
    /// for readers without a sink.
    pub(super) async fn change(&self) -> Result<SampleChange, Unreadable> {
        cooperative(poll_fn(|context| self.shared.poll(context, |shared, _| shared.take()))).await
    }
}

impl SharedReader {
    fn poll<T>(&self, context: &Context<'_>, next: impl Fn(&Self, &mut ReaderState) -> Option<T>) -> Poll<T> {
        let state = &mut *self.state.lock();
        state.is_waiting = false;
        if let Some(taken) = next(self, state) {
            return Poll::Ready(taken);
        }
        state.task = Some(context.waker().clone());
        self.reader.set_waker(Some(self.on_data.clone()));
        // A message that arrived between the read and the registration of the waker would wake
        // nobody.
        if let Some(taken) = next(self, state) {
            return Poll::Ready(taken);
        }
        state.is_waiting = true;
        Poll::Pending
    }

    /// Passes new messages to the sink, as far as it takes them. Otherwise it wakes the task.
    fn on_data(&self) {
        // Before the messages are read, so that none of them is missed.
        self.reader.set_waker(Some(self.on_data.clone()));
        let mut state = self.state.lock();
        while state.is_waiting && state.sink.is_some() {
            let Some(next) = self.next(&mut state) else { return };
            let is_taken = next.as_ref().is_ok_and(|arrived| state.sink.as_mut().is_some_and(|sink| sink(arrived)));
            if !is_taken {
                (state.left, state.is_waiting) = (Some(next), false);
            }
        }
        let task = state.task.take();
        drop(state);
        task.into_iter().for_each(Waker::wake);
    }

    fn next(&self, state: &mut ReaderState) -> Option<Result<Arrived, Unreadable>> {
        if let Some(left) = state.left.take() {
            return Some(left);
        }
        let taken = self.take()?;
        Some(taken.map(|SampleChange { sample, writer, sequence, written_ns, .. }| {
            let lost = state.gaps.before(writer, sequence);
            Arrived { writer, sample, written_ns, lost }
        }))
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

    /// Whether this participant wrote the message. Such messages came from the fabric, and would
    /// loop forever.
    fn is_own(&self, writer: GUID) -> bool {
        writer.prefix == self.reader.guid().prefix
    }
}

/// The waker that DDS's receiving thread calls.
struct OnData(Weak<SharedReader>);

impl Wake for OnData {
    fn wake(self: Arc<Self>) {
        let Some(shared) = self.0.upgrade() else { return };
        shared.on_data();
        // The end of a reader is announced through queues that this very thread empties.
        if let Some(last) = Arc::into_inner(shared) {
            _ = std::thread::Builder::new().name("dds-reader-end".into()).spawn(|| drop(last));
        }
    }
}
