//! The side that answers.

use rustdds::WriteOptionsBuilder;
use tokio::sync::Mutex;

use super::mapping::{Headless, Id, Mapping, RequestId, request, with_header};
use crate::ros2::raw::{RawReader, RawSample, RawWriter, Unreadable, WriteError};

/// A service that local clients see.
pub struct Server {
    requests: RawReader,
    replies: Mutex<RawWriter>,
    mapping: Option<Mapping>,
}

/// What a client asks.
#[derive(Clone, Debug)]
pub struct Request {
    /// For [`Server::respond`].
    pub id: RequestId,
    pub sample: RawSample,
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
    pub(super) fn new(requests: RawReader, replies: RawWriter, mapping: Option<Mapping>) -> Self {
        Self { requests, replies: Mutex::new(replies), mapping }
    }

    /// The next request. May be cancelled without losing one.
    pub async fn recv(&self) -> Result<Request, BadRequest> {
        let change = self.requests.change().await?;
        let mapping = self.mapping.unwrap_or_else(|| Mapping::of(change.writer.to_bytes()));
        let (id, sample) = request(change, mapping)?;
        Ok(Request { id, sample })
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
