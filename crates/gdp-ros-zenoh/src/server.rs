//! Servers of services.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp_util::line_limit::LineLimit;
use gdp_util::unix_time::unix_nanos;
use parking_lot::Mutex;
use tokio::sync::mpsc;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::{Query, Queryable};

use crate::attachment::Attachment;
use crate::inbox::{MessageError, attachment, cdr};
use crate::node::{ZenohError, ZenohNode};
use crate::roll::{Announced, Roll};
use crate::token::Role;
use crate::topic::Topic;

/// Bound on the requests that wait to be read. Further ones end without a response.
const REQUESTS: usize = 256;

/// One line about malformed requests in each period.
static MALFORMED: LineLimit = LineLimit::new(1, Duration::from_secs(60));

/// A server of a service, which exists until it is dropped.
pub struct RawServer {
    requests: tokio::sync::Mutex<mpsc::Receiver<ReceivedQuery>>,
    _queryable: Queryable<()>,
    announced: Mutex<Announced>,
    roll: Arc<Roll>,
    service: Topic,
}

/// A request of a client. Without a response, the client's query ends when it is dropped.
pub struct ReceivedQuery {
    pub bytes: Bytes,
    reply: Reply,
}

/// What a response needs of its request.
pub struct Reply {
    query: Query,
    attachment: Attachment,
}

impl RawServer {
    pub fn new(of: &ZenohNode, service: Topic) -> Result<Self, ZenohError> {
        let roll = of.roll()?.clone();
        let (sender, requests) = mpsc::channel(REQUESTS);
        let key = service.key(roll.domain());
        let queryable = roll.session().declare_queryable(key).complete(true).callback(move |query| {
            match ReceivedQuery::read(query) {
                // A full queue ends the query.
                Ok(request) => _ = sender.try_send(request),
                Err(error) => {
                    if let Some(more) = MALFORMED.take(Instant::now()) {
                        tracing::warn!(more, "a request of a Zenoh client is refused: {error}");
                    }
                }
            }
        });
        let queryable = queryable.wait()?;
        // Clients look for the queryable once they see the token.
        let announced = roll.announce(Role::Server, &service, "")?.into();
        Ok(Self { requests: requests.into(), _queryable: queryable, announced, roll, service })
    }

    /// Shows the server as one of the node with this full name.
    pub fn assign(&self, node: &str) -> Result<(), ZenohError> {
        let announced = self.roll.announce(Role::Server, &self.service, node)?;
        *self.announced.lock() = announced;
        Ok(())
    }

    /// Waits for the next request. Safe to cancel.
    pub async fn recv(&self) -> ReceivedQuery {
        match self.requests.lock().await.recv().await {
            Some(request) => request,
            // The session has ended.
            None => std::future::pending().await,
        }
    }
}

impl ReceivedQuery {
    fn read(query: Query) -> Result<Self, MessageError> {
        let attachment = attachment(query.attachment())?;
        let bytes = cdr(query.payload().ok_or(MessageError::Malformed)?)?;
        Ok(Self { bytes, reply: Reply { query, attachment } })
    }

    /// Separates the request from what its response needs.
    pub fn into_parts(self) -> (Bytes, Reply) {
        (self.bytes, self.reply)
    }
}

impl Reply {
    /// Sends the response: with the number and GID of the request, and the present time.
    pub async fn send(self, response: Bytes) -> Result<(), ZenohError> {
        let time_ns = i64::try_from(unix_nanos()).unwrap_or(i64::MAX);
        let attachment = Attachment { time_ns, ..self.attachment }.to_bytes();
        let key = self.query.key_expr().clone();
        let reply = self.query.reply(key, response).encoding(Encoding::ZENOH_BYTES).attachment(attachment);
        Ok(reply.await?)
    }
}
