//! Messages that subscribers have checked, until they are read.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use bytes::Bytes;
use tokio::sync::mpsc;
use zenoh::bytes::ZBytes;
use zenoh::sample::Sample;

use crate::MAX_MESSAGE;
use crate::attachment::{Attachment, AttachmentError};

/// Bound on the messages that wait.
const MESSAGES: usize = 1024;

/// Bound on their bytes.
const BYTES: usize = 128 << 20;

/// A message of another session.
#[derive(Clone, Debug)]
pub struct Received {
    pub attachment: Attachment,
    /// CDR with its encapsulation header.
    pub bytes: Bytes,
    /// The session whose clock has stamped the message: that of its publisher, or a router's.
    pub session: Option<String>,
}

/// The reason why a message is not carried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    #[error(transparent)]
    Attachment(#[from] AttachmentError),
    #[error("it is not a CDR encapsulation that ROS 2 uses")]
    Malformed,
    #[error("it has {0} bytes, and at most {MAX_MESSAGE} are carried")]
    TooLong(usize),
}

/// A message that is not carried.
#[derive(Clone, Copy, Debug)]
pub struct NotCarried {
    pub error: MessageError,
    /// Its attachment, if that is valid.
    pub attachment: Option<Attachment>,
}

/// The queue of one reader, which several subscribers fill.
pub struct Inbox {
    messages: mpsc::Receiver<Result<Received, NotCarried>>,
    slot: InboxSender,
}

/// The end of an [`Inbox`] for its subscribers.
#[derive(Clone)]
pub struct InboxSender {
    messages: mpsc::Sender<Result<Received, NotCarried>>,
    bytes: Arc<AtomicUsize>,
    lost: Arc<AtomicU64>,
}

impl Default for Inbox {
    fn default() -> Self {
        let (sender, messages) = mpsc::channel(MESSAGES);
        Self { messages, slot: InboxSender { messages: sender, bytes: Arc::default(), lost: Arc::default() } }
    }
}

impl Inbox {
    /// Waits for the next message. Safe to cancel.
    pub async fn recv(&mut self) -> Result<Received, NotCarried> {
        match self.messages.recv().await {
            Some(message) => self.taken(message),
            // The inbox has a sender itself.
            None => std::future::pending().await,
        }
    }

    /// Returns the next message, if there is one.
    pub fn try_recv(&mut self) -> Option<Result<Received, NotCarried>> {
        let message = self.messages.try_recv().ok()?;
        Some(self.taken(message))
    }

    /// Returns the messages that were lost since the last call, because they came faster than they
    /// were read.
    pub fn take_lost(&self) -> u64 {
        self.slot.lost.swap(0, Ordering::Relaxed)
    }

    pub(crate) fn slot(&self) -> InboxSender {
        self.slot.clone()
    }

    fn taken(&self, message: Result<Received, NotCarried>) -> Result<Received, NotCarried> {
        if let Ok(message) = &message {
            self.slot.bytes.fetch_sub(message.bytes.len(), Ordering::Relaxed);
        }
        message
    }
}

impl InboxSender {
    /// Checks a message and queues it, or counts it as lost if the queue is full.
    pub fn put(&self, sample: &Sample) {
        let length = sample.payload().len();
        let waiting = self.bytes.fetch_add(length, Ordering::Relaxed);
        let message = if waiting + length > BYTES { None } else { Some(received(sample)) };
        let is_kept = message.as_ref().is_some_and(Result::is_ok);
        let is_queued = message.is_some_and(|message| self.messages.try_send(message).is_ok());
        if !is_queued {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
        if !is_kept || !is_queued {
            self.bytes.fetch_sub(length, Ordering::Relaxed);
        }
    }
}

fn received(sample: &Sample) -> Result<Received, NotCarried> {
    let attachment = attachment(sample.attachment());
    let attachment = attachment.map_err(|error| NotCarried { error: error.into(), attachment: None })?;
    let bytes = cdr(sample.payload()).map_err(|error| NotCarried { error, attachment: Some(attachment) })?;
    let session = sample.timestamp().map(|timestamp| timestamp.get_id().to_string());
    Ok(Received { attachment, bytes, session })
}

/// Reads an attachment, which may be hostile.
pub fn attachment(bytes: Option<&ZBytes>) -> Result<Attachment, AttachmentError> {
    let bytes = bytes.ok_or(AttachmentError::Missing)?;
    match bytes.len() {
        crate::attachment::LENGTH => Attachment::parse(&bytes.to_bytes()),
        other => Err(AttachmentError::Length(other)),
    }
}

/// Reads a payload, which has to begin with the encapsulation header of CDR.
pub fn cdr(payload: &ZBytes) -> Result<Bytes, MessageError> {
    if payload.len() > MAX_MESSAGE {
        return Err(MessageError::TooLong(payload.len()));
    }
    let bytes = Bytes::from(payload.to_bytes().into_owned());
    if is_cdr(&bytes) { Ok(bytes) } else { Err(MessageError::Malformed) }
}

/// Whether bytes begin with the header of CDR version 1, in either byte order.
pub fn is_cdr(bytes: &[u8]) -> bool {
    matches!(bytes, [0, 0 | 1, _, _, ..])
}

#[cfg(test)]
#[path = "../tests/unit/inbox.rs"]
mod tests;
