//! The side that answers.

use std::sync::Arc;
use std::time::Duration;

use rustdds::{GUID, WriteOptionsBuilder};
use tokio::sync::{Mutex, watch};
use tokio::time::timeout;

use super::mapping::{Headless, Id, Mapping, RequestId, request, with_header};
use crate::ros2::discovery::Writers;
use crate::ros2::raw::{RawReader, RawSample, RawWriter, Unreadable, WriteError};

/// How long discovery may take to show a client whose request is here.
const SHOWN: Duration = Duration::from_secs(3);

/// A service that local clients see.
pub struct Server {
    requests: RawReader,
    replies: Mutex<RawWriter>,
    mapping: Option<Mapping>,
    writers: watch::Receiver<Arc<Writers>>,
}

/// What a client asks.
#[derive(Clone, Debug)]
pub struct Request {
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
}

impl ClientLife {
    /// Returns when discovery does not show it any more: it has said goodbye, or was not heard of for as long as it said.
    pub async fn ends(&mut self) {
        let Self { writer, writers } = self;
        _ = timeout(SHOWN, writers.wait_for(|shown| shown.contains(writer))).await;
        if writers.wait_for(|shown| !shown.contains(writer)).await.is_err() {
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
        Self { requests, replies: Mutex::new(replies), mapping, writers }
    }

    /// The next request. May be cancelled without losing one.
    pub async fn recv(&self) -> Result<Request, BadRequest> {
        let change = self.requests.change().await?;
        let mapping = self.mapping.unwrap_or_else(|| Mapping::of(change.writer.to_bytes()));
        let client = ClientLife { writer: change.writer, writers: self.writers.clone() };
        let (id, sample) = request(change, mapping)?;
        Ok(Request { id, sample, client })
    }

    /// Waits until clients have their answers, for as long as that takes.
    pub async fn settle(&self) {
        self.replies.lock().await.settle().await;
    }

    /// Answers a request, in the mapping that it came in. Waits a bounded time for clients that do not keep up.
    pub async fn respond(&self, id: &RequestId, reply: RawSample) -> Result<(), WriteError> {
        let options = WriteOptionsBuilder::new();
        let (sample, options) = match id.0 {
            Id::Header(header) => (with_header(&reply, header), options),
            Id::Sample(asked) => (reply, options.related_sample_identity(asked)),
        };
        self.replies.lock().await.write_with(sample, options.build()).await.map(drop)
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;

    use super::*;

    #[tokio::test]
    async fn a_client_ends_once_it_is_shown_no_more() {
        let [writer, other] = [1, 2].map(|number| GUID::from_bytes([number; 16]));
        let (shown, writers) = watch::channel(Arc::new(Writers::from([other])));
        let mut client = ClientLife { writer, writers };
        assert_eq!(client.ends().now_or_never(), None, "it is not shown yet");
        shown.send_replace(Arc::new(Writers::from([writer, other])));
        assert_eq!(client.ends().now_or_never(), None);
        shown.send_replace(Arc::new(Writers::from([other])));
        client.ends().await;
    }
}
