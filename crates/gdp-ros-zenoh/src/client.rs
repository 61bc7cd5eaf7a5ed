//! Clients of services.

use std::sync::atomic::{AtomicI64, AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use gdp_util::unix_time::unix_nanos;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::cancellation::CancellationToken;
use zenoh::query::{ConsolidationMode, Querier, QueryTarget};

use crate::attachment::{Attachment, AttachmentError};
use crate::inbox::{MessageError, attachment, cdr};
use crate::node::{ZenohError, ZenohNode};
use crate::roll::Announced;
use crate::token::Role;
use crate::topic::Topic;

/// Timeout of a call. A server that leaves ends it before.
const TIMEOUT: Duration = Duration::from_hours(24 * 30);

/// Bound on concurrent calls.
const MAX_CALLS: usize = 256;

/// Time between two looks for the server.
const LOOK: Duration = Duration::from_millis(20);

/// A client of the servers of a service, which exists until it is dropped.
pub struct RawClient {
    querier: Querier<'static>,
    announced: Announced,
    sequence: AtomicI64,
    calls: AtomicUsize,
}

/// Reasons for which a call has no response.
#[derive(Debug, thiserror::Error)]
pub enum QueryError {
    #[error("{MAX_CALLS} calls wait for their responses already")]
    Busy,
    #[error("the server has left or does not answer")]
    Left,
    #[error("the server's response is not carried: {0}")]
    Message(#[from] MessageError),
    #[error("Zenoh: {0}")]
    Zenoh(#[from] zenoh::Error),
}

impl RawClient {
    pub fn new(of: &ZenohNode, service: &Topic) -> Result<Self, ZenohError> {
        let roll = of.roll()?;
        let announced = roll.announce(Role::Client, service, "")?;
        let querier = roll.session().declare_querier(service.key(roll.domain()));
        // As rmw_zenoh does it: each server is asked, and each response arrives.
        let querier = querier.target(QueryTarget::AllComplete).consolidation(ConsolidationMode::None);
        let querier = querier.timeout(TIMEOUT).wait()?;
        Ok(Self { querier, announced, sequence: AtomicI64::new(1), calls: AtomicUsize::new(0) })
    }

    /// Waits without a timeout until a server can be called. Safe to cancel.
    pub async fn until_matched(&self) {
        while !self.querier.matching_status().wait().is_ok_and(|status| status.matching()) {
            tokio::time::sleep(LOOK).await;
        }
    }

    /// Calls the server, and returns the first valid response.
    pub async fn call(&self, request: Bytes) -> Result<Bytes, QueryError> {
        let open = Open::new(&self.calls)?;
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed);
        let time_ns = i64::try_from(unix_nanos()).unwrap_or(i64::MAX);
        let own = Attachment { sequence, time_ns, gid: self.announced.gid };
        let query = self.querier.get().payload(request).encoding(Encoding::ZENOH_BYTES).attachment(own.to_bytes());
        let replies = query.cancellation_token(open.token.clone()).await?;
        let mut refused = QueryError::Left;
        while let Ok(reply) = replies.recv_async().await {
            let Ok(sample) = reply.into_result() else { continue };
            match attachment(sample.attachment()) {
                Ok(theirs) if (theirs.sequence, theirs.gid) == (own.sequence, own.gid) => {}
                Ok(_) => continue,
                Err(error) => {
                    refused = reason(error);
                    continue;
                }
            }
            match cdr(sample.payload()) {
                Ok(response) => return Ok(response),
                Err(error) => refused = error.into(),
            }
        }
        Err(refused)
    }
}

fn reason(error: AttachmentError) -> QueryError {
    MessageError::from(error).into()
}

/// A call that waits for its response. Zenoh would remember it until its timeout, so it is
/// cancelled at the end, after the receiver of its replies is dropped.
struct Open<'a> {
    calls: &'a AtomicUsize,
    token: CancellationToken,
}

impl<'a> Open<'a> {
    fn new(calls: &'a AtomicUsize) -> Result<Self, QueryError> {
        let open = calls.fetch_add(1, Ordering::Relaxed);
        let this = Self { calls, token: CancellationToken::default() };
        if open < MAX_CALLS { Ok(this) } else { Err(QueryError::Busy) }
    }
}

impl Drop for Open<'_> {
    fn drop(&mut self) {
        self.calls.fetch_sub(1, Ordering::Relaxed);
        // The result says only whether something was left to cancel.
        _ = self.token.cancel().wait();
    }
}
