//! Datagrams on a stream: each after its length in 16 bits (RFC 4571), or each as a binary message
//! of a WebSocket (RFC 6455).

use std::future::ready;
use std::io;
use std::pin::Pin;

use bytes::{Bytes, BytesMut};
use futures::{Sink, SinkExt, Stream, StreamExt, TryStreamExt};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_util::codec::LengthDelimitedCodec;

use crate::port::UDP_MTU;

/// Size of the largest datagram in bytes: that of a link over UDP.
pub const MAX_DATAGRAM: usize = UDP_MTU as usize;

/// First byte of a WebSocket's request, `GET /`. As the first byte of a length it would exceed
/// [`MAX_DATAGRAM`].
pub const FIRST_WEBSOCKET_BYTE: u8 = b'G';

const _: () = assert!(MAX_DATAGRAM < (FIRST_WEBSOCKET_BYTE as usize) << 8);

/// Size of a WebSocket's read buffer in bytes.
const READ_BUFFER: usize = 16 << 10;

pub type Incoming = Pin<Box<dyn Stream<Item = io::Result<Bytes>> + Send>>;
pub type Outgoing = Pin<Box<dyn Sink<Bytes, Error = io::Error> + Send>>;

/// Returns the datagrams of a stream with lengths.
pub fn by_length(stream: impl AsyncRead + AsyncWrite + Send + 'static) -> (Incoming, Outgoing) {
    let mut codec = LengthDelimitedCodec::builder();
    let framed = codec.length_field_type::<u16>().max_frame_length(MAX_DATAGRAM).new_framed(stream);
    let (outgoing, incoming) = framed.split();
    (Box::pin(incoming.map_ok(BytesMut::freeze)), Box::pin(outgoing))
}

/// Returns the datagrams of a WebSocket. A text message is an error.
pub fn by_message<S>(stream: WebSocketStream<S>) -> (Incoming, Outgoing)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let (outgoing, incoming) = stream.split();
    let incoming = incoming.map_err(io::Error::other).try_filter_map(|message| {
        ready(match message {
            Message::Binary(datagram) => Ok(Some(datagram)),
            Message::Text(_) => Err(io::Error::new(io::ErrorKind::InvalidData, "a text message, not a datagram")),
            _ => Ok(None),
        })
    });
    let outgoing = outgoing.with(|datagram| ready(Ok::<_, Error>(Message::Binary(datagram))));
    (Box::pin(incoming), Box::pin(outgoing.sink_map_err(io::Error::other)))
}

/// Returns the bounds of a WebSocket.
pub fn websocket_config() -> WebSocketConfig {
    WebSocketConfig::default()
        .read_buffer_size(READ_BUFFER)
        .write_buffer_size(0)
        .max_write_buffer_size(4 * MAX_DATAGRAM)
        .max_message_size(Some(MAX_DATAGRAM))
        .max_frame_size(Some(MAX_DATAGRAM))
}

#[cfg(test)]
#[path = "../../tests/unit/tunnel/framing.rs"]
mod tests;
