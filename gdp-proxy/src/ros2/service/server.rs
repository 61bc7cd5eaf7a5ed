//! The server of a DDS service.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::Duration;

use rustdds::{GUID, WriteOptionsBuilder};
use tokio::sync::{Mutex, watch};
use tokio::time::timeout;

use super::mapping::{Headless, Id, Mapping, RequestId, request, with_header};
use crate::ros2::discovery::Writers;
use crate::ros2::raw::{Participant, RawWriter, WriteError, participant};
use crate::ros2::raw_reader::{RawReader, Unreadable};
use crate::ros2::sample::RawSample;

/// Timeout for discovery to announce a client whose request has arrived.
const MATCH_TIMEOUT: Duration = Duration::from_secs(3);

/// Timeout for the discovery of a client's reader of replies after its request has arrived.
const REACHED: Duration = Duration::from_millis(500);

/// Bound on the participants whose matched readers are counted.
const MAX_SERVED: usize = 4096;

/// A service that local clients see.
pub struct Server {
    requests: RawReader,
    replies: Mutex<Replies>,
    mapping: Option<Mapping>,
    writers: watch::Receiver<Arc<Writers>>,
}

/// A request of a client.
#[derive(Clone, Debug)]
pub struct ReceivedRequest {
    /// The identity for [`Server::respond`].
    pub id: RequestId,
    pub sample: RawSample,
    pub client: ClientLife,
}

/// An observer of whether a client still exists.
#[derive(Clone, Debug)]
pub struct ClientLife {
    writer: GUID,
    writers: watch::Receiver<Arc<Writers>>,
    /// True once discovery has announced the client.
    is_matched: bool,
}

impl ClientLife {
    /// Waits until discovery has removed the client, because it announced its departure or its
    /// lease expired.
    pub async fn ends(&mut self) {
        let Self { writer, writers, is_matched } = self;
        *is_matched =
            *is_matched || timeout(MATCH_TIMEOUT, writers.wait_for(|shown| shown.contains(writer))).await.is_ok();
        // A client that was never announced cannot be missed.
        if !*is_matched || writers.wait_for(|shown| !shown.contains(writer)).await.is_err() {
            // Discovery has ended, because the proxy leaves the domain.
            std::future::pending().await
        }
    }
}

/// An invalid request, which is not answered. The text is for the log.
#[derive(Debug, thiserror::Error)]
pub enum BadRequest {
    #[error(transparent)]
    Unreadable(#[from] Unreadable),
    #[error(transparent)]
    Headless(#[from] Headless),
}

impl Server {
    /// Moves both endpoints to the ROS node with this full name, which may be a remote one.
    pub fn assign(&self, node: &str) {
        self.requests.assign(node);
        // Nobody answers yet.
        if let Ok(mut replies) = self.replies.try_lock() {
            replies.writer.assign(node);
        }
    }

    pub(super) fn new(
        requests: RawReader,
        replies: RawWriter,
        mapping: Option<Mapping>,
        writers: watch::Receiver<Arc<Writers>>,
    ) -> Self {
        Self { requests, replies: Mutex::new(Replies { writer: replies, served: HashMap::new() }), mapping, writers }
    }

    /// Waits for the next request. A cancelled call loses no request.
    pub async fn recv(&self) -> Result<ReceivedRequest, BadRequest> {
        let change = self.requests.change().await?;
        let mapping = self.mapping.unwrap_or_else(|| Mapping::of(change.writer.to_bytes()));
        let client = ClientLife { writer: change.writer, writers: self.writers.clone(), is_matched: false };
        let (id, sample) = request(change, mapping)?;
        Ok(ReceivedRequest { id, sample, client })
    }

    /// Waits without a timeout until clients have their answers.
    pub async fn settle(&self) {
        self.replies.lock().await.writer.settle().await;
    }

    /// Answers a request in the client's mapping. It waits a bounded time for the sockets of this
    /// host, or for the discovery of the client's reader.
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

/// The writer of replies, and the clients that it has matched.
struct Replies {
    writer: RawWriter,
    served: HashMap<Participant, Served>,
}

/// The number of matched readers of one participant, and its clients with answered requests. Each
/// of these clients has a reader of its own.
#[derive(Default)]
struct Served {
    readers: usize,
    clients: HashSet<GUID>,
}

impl Replies {
    /// Waits until the client's reader of replies is matched. The request may arrive before the
    /// reader is discovered, and a reply written by then would not reach it.
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
                    // It is unknown to which client the reader belonged.
                    *of = Served { readers: of.readers.saturating_sub(1), clients: HashSet::new() };
                }
            }
        };
        if timeout(REACHED, until_served).await.is_err() {
            // The timeout is waited for once only.
            served.entry(of_client).or_default().readers = wanted;
        }
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/ros2/service/server.rs"]
mod tests;
