//! A service that this node serves: requests and responses as bytes.

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

/// Time for a caller to take its response.
const TAKEN: Duration = Duration::from_secs(60);

/// A service's type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceType {
    /// Such as `std_srvs/SetBool`.
    pub name: String,
    /// Of request and response, in hexadecimal.
    pub md5sum: String,
}

/// A call of a service of ours.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceRequest {
    /// As serialized by ROS 1, without the length in front.
    pub data: Bytes,
    /// The calling node's name.
    pub caller_id: String,
}

type Answer = Pin<Box<dyn Future<Output = Result<Bytes, String>> + Send>>;

/// Answers a request, or says why not: the caller sees that text.
pub type Handler = Box<dyn Fn(ServiceRequest) -> Answer + Send + Sync>;

pub struct Service {
    pub name: String,
    kind: ServiceType,
    caller_id: String,
    max_message: usize,
    handler: Handler,
    /// Requests that are answered at once.
    running: Semaphore,
    /// Connections end when it goes.
    alive: watch::Sender<()>,
    answers: Answers,
}

/// Held to read by whoever has a request, until its answer is written.
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

    /// Serves one who asks for this service by `header`: one request, or as many as come if it says
    /// so.
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
                    // Nobody waits for the answer any more.
                    () = closed(&mut stream.reader) => return Ok(()),
                };
                let written = timeout(TAKEN, stream.writer.write_all(&encode(answer))).await;
                written.map_err(|_| TcprosError::Timeout(TAKEN))??;
                // Only now, so that it is answered even if the service is given up meanwhile.
                drop(service);
                if !header.is_set("persistent") {
                    return Ok(());
                }
            }
        };
        tokio::select! {
            // The sender has gone: nothing is ever sent.
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

/// Until the peer hangs up. One that asks on before it is answered stays.
async fn closed(reader: &mut (impl AsyncBufReadExt + Unpin)) {
    match reader.fill_buf().await {
        Ok([]) | Err(_) => {}
        Ok(_) => std::future::pending().await,
    }
}

/// One byte says whether it is a response (1) or the text of an error (0).
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
