//! A service that this node serves. Requests and responses are bytes.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use bytes::{BufMut, Bytes, BytesMut};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt};
use tokio::sync::{RwLock, Semaphore, watch};
use tokio::time::timeout;

use crate::tcpros::listener::refuse;
use crate::tcpros::{Header, Stream, TcprosError};
use crate::topic::publication::check;

/// Timeout for a client to read its response.
const TAKEN: Duration = Duration::from_secs(60);

/// The type of a service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceType {
    /// The name, such as `std_srvs/SetBool`.
    pub name: String,
    /// The MD5 sum of request and response, in hexadecimal.
    pub md5sum: String,
}

/// A request to a service of this node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceRequest {
    /// The request in ROS 1 serialization, without the length prefix.
    pub data: Bytes,
    /// The name of the calling node.
    pub caller_id: String,
}

type Answer = Pin<Box<dyn Future<Output = Result<Bytes, String>> + Send>>;

/// Returns the response to a request, or an error text for the client.
pub type Handler = Box<dyn Fn(ServiceRequest) -> Answer + Send + Sync>;

pub struct Service {
    pub name: String,
    kind: ServiceType,
    caller_id: String,
    max_message: usize,
    handler: Handler,
    /// Permits for the calls of `handler` that may run at once.
    running: Semaphore,
    /// Closed when the service is dropped, which ends its connections.
    alive: watch::Sender<()>,
    answers: Answers,
}

/// A lock that each call holds for reading until its response is written.
pub type Answers = Arc<RwLock<()>>;

impl Service {
    pub fn new(
        name: String,
        kind: ServiceType,
        concurrency: usize,
        caller_id: String,
        max_message: usize,
        handler: Handler,
        answers: Answers,
    ) -> Self {
        let (running, alive) = (Semaphore::new(concurrency), watch::channel(()).0);
        Self { name, kind, caller_id, max_message, handler, running, alive, answers }
    }

    /// Serves a client that connected with `header`: one request, or several if the header has
    /// `persistent`.
    pub async fn serve(self: Arc<Self>, mut stream: Stream, header: Header) -> Result<(), TcprosError> {
        let caller_id = match check(&header, &self.kind.name, &self.kind.md5sum) {
            Ok(caller_id) => caller_id.to_owned(),
            Err(reason) => return refuse(stream, &reason).await,
        };
        let mut alive = self.alive.subscribe();
        let answering = Arc::downgrade(&self);
        stream.write_header(&self.header()).await?;
        let max_message = self.max_message;
        drop(self);
        if header.is_set("probe") {
            return Ok(());
        }
        let serving = async {
            loop {
                let data = match stream.read_message(max_message).await {
                    Err(TcprosError::Closed) => return Ok(()),
                    data => data?,
                };
                let Some(service) = answering.upgrade() else { return Ok(()) };
                let _answering = service.answers.clone().read_owned().await;
                let request = ServiceRequest { data, caller_id: caller_id.clone() };
                let answer = tokio::select! {
                    answer = service.answer(request) => answer,
                    // The client has closed the connection.
                    () = closed(&mut stream.reader) => return Ok(()),
                };
                let written = timeout(TAKEN, stream.writer.write_all(&encode(answer))).await;
                written.map_err(|_| TcprosError::Timeout(TAKEN))??;
                // The service must live until here, so that dropping its handle does not cancel the
                // response.
                drop(service);
                if !header.is_set("persistent") {
                    return Ok(());
                }
            }
        };
        tokio::select! {
            // The channel closes when the service is dropped; it never carries a value.
            _ = alive.changed() => Ok(()),
            served = serving => served,
        }
    }

    async fn answer(&self, request: ServiceRequest) -> Result<Bytes, String> {
        // The semaphore is never closed.
        let _permit = self.running.acquire().await.map_err(|_| "the service is gone".to_owned())?;
        (self.handler)(request).await
    }

    fn header(&self) -> Header {
        let ServiceType { name, md5sum } = &self.kind;
        Header::new([
            ("callerid", self.caller_id.as_str()),
            ("md5sum", md5sum),
            ("request_type", &format!("{name}Request")),
            ("response_type", &format!("{name}Response")),
            ("service", &self.name),
            ("type", name),
        ])
    }
}

/// Waits until the peer closes the connection. Never returns if the peer sends another request
/// first.
async fn closed(reader: &mut (impl AsyncBufReadExt + Unpin)) {
    match reader.fill_buf().await {
        Ok([]) | Err(_) => {}
        Ok(_) => std::future::pending().await,
    }
}

/// Encodes a response after the byte 1, or the text of an error after the byte 0.
fn encode(answer: Result<Bytes, String>) -> Bytes {
    let (ok, data) = match answer {
        Ok(data) => (1, data),
        Err(text) => (0, text.into()),
    };
    let (ok, data) = match u32::try_from(data.len()) {
        Ok(_) => (ok, data),
        Err(_) => (0, Bytes::from_static(b"the response has more than the 4 GiB that TCPROS can carry")),
    };
    let mut bytes = BytesMut::with_capacity(5 + data.len());
    bytes.put_u8(ok);
    bytes.put_u32_le(data.len() as u32);
    bytes.put(data);
    bytes.freeze()
}
