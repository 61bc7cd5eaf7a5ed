//! The client of a DDS service.

use std::collections::HashMap;
use std::sync::Arc;

use parking_lot::Mutex;
use rustdds::{GUID, WriteOptionsBuilder};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use super::mapping::{Id, Mapping, RequestId, asker, header, reply, with_header};
use crate::ros2::raw::{RawWriter, WriteError};
use crate::ros2::raw_reader::RawReader;
use crate::ros2::sample::{RawSample, Representation};

/// Bound on the concurrent calls of one client.
const MAX_CALLS: usize = 1024;

/// A client of a service of local servers. Calls may run concurrently.
pub struct DdsClient {
    mapping: Mapping,
    replies: Arc<RawReader>,
    asking: tokio::sync::Mutex<Asking>,
    calls: Arc<Mutex<Calls>>,
    listening: JoinHandle<()>,
}

struct Asking {
    requests: RawWriter,
    number: u64,
}

/// The pending calls, and replies that arrived before the write returned the identity of their
/// request.
#[derive(Default)]
struct Calls {
    waiting: HashMap<RequestKey, oneshot::Sender<RawSample>>,
    /// True while a request is written. At most one is written at a time, and its key is unknown
    /// until then.
    writing: bool,
    early: HashMap<RequestKey, RawSample>,
}

/// The identity of a request of this client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum RequestKey {
    Header([u8; super::mapping::HEADER]),
    Sequence(i64),
}

/// Reasons for which a call has no reply.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    #[error("{MAX_CALLS} calls of the service are under way: does its server answer at all?")]
    Busy,
    #[error("the request is big-endian CDR: encode it little-endian")]
    BigEndian,
    #[error("the request was not sent: {0}")]
    Write(#[from] WriteError),
    #[error("the client was closed while a call was under way")]
    Closed,
}

impl DdsClient {
    pub(super) fn new(replies: RawReader, requests: RawWriter, mapping: Mapping) -> Self {
        let (calls, replies) = (Arc::new(Mutex::new(Calls::default())), Arc::new(replies));
        let own = [replies.guid(), requests.guid()];
        let listening = tokio::spawn(listen(replies.clone(), own, mapping, calls.clone()));
        let asking = tokio::sync::Mutex::new(Asking { requests, number: 0 });
        Self { mapping, replies, asking, calls, listening }
    }

    /// Waits until the endpoints of the participant of `server` are matched in both directions.
    /// Each match is reported once. A request that arrives before the server has discovered this
    /// client is retransmitted, because the topic is reliable.
    pub async fn until_matched(&self, server: [u8; 16]) {
        let participant = std::array::from_fn(|i| server[i]);
        let asking = self.asking.lock().await;
        tokio::join!(asking.requests.until_matched(participant), self.replies.until_matched(server));
    }

    /// Sends a request and waits for the reply without a timeout. Dropping the future cancels the
    /// call: a later reply is ignored.
    pub async fn call(&self, request: RawSample) -> Result<RawSample, CallError> {
        let (pending, arrival) = self.ask(request).await?;
        let answer = arrival.await.map_err(|_| CallError::Closed);
        drop(pending);
        answer
    }

    async fn ask(&self, request: RawSample) -> Result<(Pending, oneshot::Receiver<RawSample>), CallError> {
        // A big-endian request would use another DDS writer, which replies would not name.
        if request.representation == Representation::CdrBe {
            return Err(CallError::BigEndian);
        }
        let mut asking = self.asking.lock().await;
        let _writing = Writing::begin(&self.calls)?;
        asking.number += 1;
        let key = match self.mapping {
            Mapping::Cyclone => {
                let header = header(asking.requests.guid(), asking.number);
                let options = WriteOptionsBuilder::new().build();
                asking.requests.write_with(with_header(&request, header), options).await?;
                RequestKey::Header(header)
            }
            Mapping::Enhanced => {
                let options = WriteOptionsBuilder::new().related_sample_identity(asker(self.replies.guid())).build();
                let written = asking.requests.write_with(request, options).await?;
                RequestKey::Sequence(written.sequence_number.into())
            }
        };
        let (sender, arrival) = oneshot::channel();
        let mut calls = self.calls.lock();
        match calls.early.remove(&key) {
            Some(reply) => _ = sender.send(reply),
            None => _ = calls.waiting.insert(key, sender),
        }
        Ok((Pending { key, calls: self.calls.clone() }, arrival))
    }
}

impl Drop for DdsClient {
    fn drop(&mut self) {
        self.listening.abort();
    }
}

/// While this exists, replies to unknown requests are stored.
struct Writing<'a>(&'a Mutex<Calls>);

impl<'a> Writing<'a> {
    fn begin(calls: &'a Mutex<Calls>) -> Result<Self, CallError> {
        let mut locked = calls.lock();
        if locked.waiting.len() >= MAX_CALLS {
            return Err(CallError::Busy);
        }
        locked.writing = true;
        Ok(Self(calls))
    }
}

impl Drop for Writing<'_> {
    fn drop(&mut self) {
        let mut calls = self.0.lock();
        calls.writing = false;
        calls.early.clear();
    }
}

/// A pending call, which is removed when this is dropped.
struct Pending {
    key: RequestKey,
    calls: Arc<Mutex<Calls>>,
}

impl Drop for Pending {
    fn drop(&mut self) {
        self.calls.lock().waiting.remove(&self.key);
    }
}

async fn listen(replies: Arc<RawReader>, own: [GUID; 2], mapping: Mapping, calls: Arc<Mutex<Calls>>) {
    loop {
        let heard = match replies.change().await {
            Ok(change) => reply(change, mapping).map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        };
        let (id, sample) = match heard {
            Ok(Some(heard)) => heard,
            // A reply of a server with another mapping, to another client.
            Ok(None) => continue,
            Err(error) => {
                tracing::debug!("a reply is ignored: {error}");
                continue;
            }
        };
        let Some(key) = own_key(&id, own) else { continue };
        let mut calls = calls.lock();
        match calls.waiting.remove(&key) {
            Some(call) => _ = call.send(sample),
            None if calls.writing && calls.early.len() < MAX_EARLY => _ = calls.early.insert(key, sample),
            None => {}
        }
    }
}

/// Bound on the replies stored while one request is written: its own, and late ones to cancelled
/// calls.
const MAX_EARLY: usize = 16;

/// Returns the key of the request if the reply is to this client. Replies go to all clients of a
/// service.
fn own_key(id: &RequestId, own: [GUID; 2]) -> Option<RequestKey> {
    match id.0 {
        Id::Header(header) => (header[..8] == own[1].to_bytes()[8..]).then_some(RequestKey::Header(header)),
        Id::Sample(asked) => {
            own.contains(&asked.writer_guid).then_some(RequestKey::Sequence(asked.sequence_number.into()))
        }
    }
}
