//! The server of a DDS service.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use rustdds::{GUID, WriteOptionsBuilder};
use tokio::sync::{Mutex, watch};
use tokio::time::timeout;

use super::mapping::{Headless, Id, Mapping, RequestId, request, with_header};
use crate::ros2::discovery::Writers;
use crate::ros2::raw::{Participant, RawReader, RawSample, RawWriter, Unreadable, WriteError, participant};

/// How long discovery may take to show a client whose request is here.
const MATCH_TIMEOUT: Duration = Duration::from_secs(3);

/// How long a client's reader of replies may take to be discovered once its request is here.
const REACHED: Duration = Duration::from_millis(500);

/// Participants that are told apart.
const MAX_SERVED: usize = 4096;

/// A service that local clients see.
pub struct Server {
    requests: RawReader,
    replies: Mutex<Replies>,
    mapping: Option<Mapping>,
    writers: watch::Receiver<Arc<Writers>>,
}

/// What a client asks.
#[derive(Clone, Debug)]
pub struct ReceivedRequest {
    /// For [`Server::respond`].
    pub id: RequestId,
    pub sample: RawSample,
    pub client: ClientLife,
}

/// Sees whether a client is there.
#[derive(Clone, Debug)]
pub struct ClientLife {
    writer: GUID,
    writers: watch::Receiver<Arc<Writers>>,
    /// Discovery has shown it.
    is_matched: bool,
}

impl ClientLife {
    /// Returns when discovery does not show it any more: it has said goodbye, or was not heard of
    /// for as long as it said.
    pub async fn ends(&mut self) {
        let Self { writer, writers, is_matched } = self;
        *is_matched =
            *is_matched || timeout(MATCH_TIMEOUT, writers.wait_for(|shown| shown.contains(writer))).await.is_ok();
        // Who was never shown is not missed.
        if !*is_matched || writers.wait_for(|shown| !shown.contains(writer)).await.is_err() {
            // Nobody discovers any more: the domain is being left.
            std::future::pending().await
        }
    }
}

/// A request that cannot be understood, and is not answered. The text is for the log.
#[derive(Debug, thiserror::Error)]
pub enum BadRequest {
    #[error(transparent)]
    Unreadable(#[from] Unreadable),
    #[error(transparent)]
    Headless(#[from] Headless),
}

impl Server {
    pub(super) fn new(
        requests: RawReader,
        replies: RawWriter,
        mapping: Option<Mapping>,
        writers: watch::Receiver<Arc<Writers>>,
    ) -> Self {
        Self { requests, replies: Mutex::new(Replies { writer: replies, served: HashMap::new() }), mapping, writers }
    }

    /// The next request. May be cancelled without losing one.
    pub async fn recv(&self) -> Result<ReceivedRequest, BadRequest> {
        let change = self.requests.change().await?;
        let mapping = self.mapping.unwrap_or_else(|| Mapping::of(change.writer.to_bytes()));
        let client = ClientLife { writer: change.writer, writers: self.writers.clone(), is_matched: false };
        let (id, sample) = request(change, mapping)?;
        Ok(ReceivedRequest { id, sample, client })
    }

    /// Waits until clients have their answers, for as long as that takes.
    pub async fn settle(&self) {
        self.replies.lock().await.writer.settle().await;
    }

    /// Answers a request of a client, in the mapping that it came in. Waits a bounded time for the
    /// sockets of this host, or for a client whose reader is not discovered yet.
    pub async fn respond(&self, id: &RequestId, client: &ClientLife, reply: RawSample) -> Result<(), WriteError> {
        let options = WriteOptionsBuilder::new();
        let (sample, options) = match id.0 {
            Id::Header(header) => (with_header(&reply, header), options),
            Id::Sample(asked) => (reply, options.related_sample_identity(asked)),
        };
        let mut replies = self.replies.lock().await;
        replies.reach(client.writer).await;
        replies.writer.write_with(sample, options.build()).await.map(drop)
    }
}

/// The writer of replies, and whom it serves.
struct Replies {
    writer: RawWriter,
    served: HashMap<Participant, Served>,
}

/// Of one participant: how many readers are served, and whose requests were answered; each of these
/// has a reader of its own.
#[derive(Default)]
struct Served {
    readers: usize,
    clients: HashSet<GUID>,
}

impl Replies {
    /// Has a client served: its request may come before its reader of replies is discovered, and
    /// what is written by then does not reach it.
    async fn reach(&mut self, client: GUID) {
        let Self { writer, served } = self;
        let of_client = participant(client);
        if !served.contains_key(&of_client) && served.len() >= MAX_SERVED {
            served.clear();
        }
        let wanted = {
            let clients = &mut served.entry(of_client).or_default().clients;
            clients.insert(client);
            clients.len()
        };
        let until_served = async {
            while served.get(&of_client).is_none_or(|of| of.readers < wanted) {
                let (reader, is_served) = writer.matching().await;
                let of = served.entry(participant(reader)).or_default();
                if is_served {
                    of.readers += 1;
                } else {
                    // Whose it was cannot be told.
                    *of = Served { readers: of.readers.saturating_sub(1), clients: HashSet::new() };
                }
            }
        };
        if timeout(REACHED, until_served).await.is_err() {
            // It was waited for once.
            served.entry(of_client).or_default().readers = wanted;
        }
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/ros2/service/server.rs"]
mod tests;
