//! One connection to a publisher. It requests the publisher's address, connects, and reads until
//! the connection ends.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::mpsc;
use tokio::time::timeout;

use crate::api::RpcError;
use crate::api::slave::request_topic;
use crate::queue::Queue;
use crate::tcpros::{Header, Stream, TcprosError};
use crate::topic::message::{Message, PublisherInfo};

/// The state that all connections of one subscription share.
pub struct Common {
    pub topic: String,
    /// The type, or `*` for any.
    pub kind: String,
    /// The MD5 sum, or `*` for any.
    pub md5sum: String,
    pub caller_id: String,
    /// Maximum size of a message, in bytes.
    pub max_message: usize,
    /// Timeout of `requestTopic`, and of the connection with its handshake.
    pub timeout: Duration,
    pub queue: Queue<Message>,
}

/// The reason why a connection to a publisher failed.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    #[error("it does not say where to connect: {0}")]
    Request(#[from] RpcError),
    #[error("no connection to {address}: {source}")]
    Connection { address: String, source: TcprosError },
}

/// Connects, reports that to `connected`, and queues the messages. Returns the reason of the end.
pub async fn run(
    common: &Common,
    publisher: &str,
    connected: mpsc::Sender<Arc<PublisherInfo>>,
) -> Result<std::convert::Infallible, LinkError> {
    let (host, port) = request_topic(publisher, &common.caller_id, &common.topic, common.timeout).await?;
    let failed = |source| LinkError::Connection { address: format!("{host}:{port}"), source };
    let greeted = timeout(common.timeout, common.greet(&host, port)).await;
    let (mut stream, header) = greeted.unwrap_or(Err(TcprosError::Timeout(common.timeout))).map_err(failed)?;
    let info = Arc::new(common.info(publisher, &header).map_err(failed)?);
    // Without a receiver the subscription is ending, and this task with it.
    _ = connected.send(info.clone()).await;
    loop {
        let data = stream.read_message(common.max_message).await.map_err(failed)?;
        let bytes = data.len();
        common.queue.push(Message { data, publisher: info.clone() }, bytes);
    }
}

impl Common {
    async fn greet(&self, host: &str, port: u16) -> Result<(Stream, Header), TcprosError> {
        let mut stream = Stream::connect(host, port).await?;
        let ours = Header::new([
            ("callerid", self.caller_id.as_str()),
            ("md5sum", &self.md5sum),
            ("tcp_nodelay", "1"),
            ("topic", &self.topic),
            ("type", &self.kind),
        ]);
        let theirs = stream.greet(&ours).await?;
        Ok((stream, theirs))
    }

    fn info(&self, publisher: &str, header: &Header) -> Result<PublisherInfo, TcprosError> {
        let field = |name: &'static str| match header.get(name) {
            Some(value) if !value.is_empty() => Ok(value.to_owned()),
            _ => Err(TcprosError::Missing(name)),
        };
        let same = |name: &'static str, theirs: &str, ours: &str| {
            let (theirs, ours) = (theirs.to_owned(), ours.to_owned());
            if ours == "*" || ours == theirs { Ok(()) } else { Err(TcprosError::Differs { field: name, theirs, ours }) }
        };
        let info = PublisherInfo {
            uri: publisher.to_owned(),
            // Not all implementations send it.
            caller_id: header.get("callerid").unwrap_or_default().to_owned(),
            kind: field("type")?,
            md5sum: field("md5sum")?,
            definition: header.get("message_definition").unwrap_or_default().to_owned(),
            latching: header.is_set("latching"),
        };
        same("type", &info.kind, &self.kind)?;
        same("md5sum", &info.md5sum, &self.md5sum)?;
        Ok(info)
    }
}
