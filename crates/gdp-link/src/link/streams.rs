//! Requests and responses on the streams of a connection.
//!
//! They are bounded in size, number and time. Streams are independent: a peer that leaves a request
//! half-written delays only itself.

use std::time::Duration;

use quinn::{Connection, ReadExactError, RecvStream, SendStream, VarInt};
use tokio::sync::mpsc;
use tokio::time::timeout;

use crate::link::error::LinkError;
use crate::link::timing::REQUEST_TIMEOUT;
use gdp_proto::control;
use gdp_proto::control::{CodecError, MAX_MESSAGE, Refusal, RefusalCode, Request, Response};

/// Maximum time for reading a request.
const READ_TIMEOUT: Duration = REQUEST_TIMEOUT;

/// Sends the response to a request. Dropping it without a response resets the stream.
pub struct Responder(Option<SendStream>);

impl Responder {
    /// Sends the response. Fails if the stream has failed, for example because the peer has
    /// disconnected.
    pub async fn respond(mut self, response: Response) -> Result<(), LinkError> {
        let Some(mut stream) = self.0.take() else { return Ok(()) };
        let bytes = control::encode(&response).or_else(|error| {
            control::encode(&Response::from(Refusal::new(
                RefusalCode::Limit,
                format!("the answer does not fit: {error}"),
            )))
        })?;
        write_message(&mut stream, &bytes).await
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        if let Some(mut stream) = self.0.take() {
            let _ = stream.reset(VarInt::from_u32(0));
        }
    }
}

pub async fn request(connection: &Connection, request: &Request) -> Result<Response, LinkError> {
    let bytes = control::encode(request)?;
    let exchange = async {
        let (mut send, mut recv) = connection.open_bi().await?;
        write_message(&mut send, &bytes).await?;
        let answer = read_message(&mut recv, MAX_MESSAGE).await?;
        Ok(control::decode(&answer)?)
    };
    timeout(REQUEST_TIMEOUT, exchange)
        .await
        .unwrap_or(Err(LinkError::Timeout { what: "the answer to a request", after: REQUEST_TIMEOUT }))
}

/// The receivers of the peer's requests.
#[derive(Clone)]
pub struct Takers {
    pub requests: mpsc::Sender<(Request, Responder)>,
    /// Changes of keys, which the link processes itself.
    pub announcements: mpsc::Sender<Announcement>,
}

/// Reads the peer's requests until the connection closes. QUIC bounds the number of streams.
pub async fn serve(connection: Connection, takers: Takers) {
    while let Ok((send, recv)) = connection.accept_bi().await {
        tokio::spawn(read_request(send, recv, takers.clone()));
    }
}

async fn read_request(send: SendStream, mut recv: RecvStream, takers: Takers) {
    let responder = Responder(Some(send));
    match timeout(READ_TIMEOUT, read_message(&mut recv, MAX_MESSAGE)).await {
        Ok(Ok(bytes)) => match control::decode(&bytes) {
            Ok(Request::Ratcheted { generation }) => {
                // If the queue is full or no task runs `keep_keys`, the announcement is not
                // answered. The peer then repeats it.
                let _ = takers.announcements.try_send((generation, responder));
            }
            Ok(request) => {
                // The receiver is dropped only with the link.
                let _ = takers.requests.send((request, responder)).await;
            }
            Err(error) => refuse(responder, &error).await,
        },
        Ok(Err(LinkError::Codec(error))) => refuse(responder, &error).await,
        Ok(Err(_)) | Err(_) => {}
    }
}

async fn refuse(responder: Responder, error: &CodecError) {
    let _ = responder.respond(Refusal::new(error.code(), error.to_string()).into()).await;
}

/// Writes an encoded message and ends the stream in this direction.
pub async fn write_message(stream: &mut SendStream, bytes: &[u8]) -> Result<(), LinkError> {
    stream.write_all(bytes).await.map_err(|error| LinkError::Closed(error.to_string()))?;
    stream.finish().map_err(|error| LinkError::Closed(error.to_string()))
}

/// Reads one message of at most `most` bytes. Allocates memory only for bytes that have arrived.
pub async fn read_message(stream: &mut RecvStream, most: usize) -> Result<Vec<u8>, LinkError> {
    let mut prefix = [0; 4];
    read_exact(stream, &mut prefix).await?;
    let length = control::decode_length(prefix)?;
    if length > most {
        return Err(LinkError::Protocol(format!("a message of {length} bytes where at most {most} are expected")));
    }
    let mut message = Vec::new();
    let mut chunk = [0; 4096];
    while message.len() < length {
        let part = &mut chunk[..(length - message.len()).min(4096)];
        let read = stream.read(part).await.map_err(|error| LinkError::Closed(error.to_string()))?;
        let Some(read) = read else { return Err(LinkError::Protocol("a message ends too early".into())) };
        message.extend_from_slice(&part[..read]);
    }
    Ok(message)
}

async fn read_exact(stream: &mut RecvStream, buffer: &mut [u8]) -> Result<(), LinkError> {
    stream.read_exact(buffer).await.map_err(|error| match error {
        ReadExactError::FinishedEarly(_) => LinkError::Protocol("a message ends too early".into()),
        ReadExactError::ReadError(error) => LinkError::Closed(error.to_string()),
    })
}

/// Maximum number of queued announcements. A peer has one outstanding; an older one may still be in
/// flight.
pub const MAX_ANNOUNCEMENTS: usize = 4;

/// The generation of the key that the peer's frames now use, and the responder for the answer.
pub type Announcement = (u64, Responder);
