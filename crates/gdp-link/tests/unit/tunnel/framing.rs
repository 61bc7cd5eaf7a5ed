//! Unit tests of both framings, over a pipe in memory.

use futures::{SinkExt, StreamExt};
use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};
use tokio_tungstenite::tungstenite::protocol::Role;

use super::*;

const PIPE: usize = 64 << 10;

#[tokio::test]
async fn datagrams_have_a_length_of_two_bytes() {
    let (near, mut far) = duplex(PIPE);
    let (_incoming, mut outgoing) = by_length(near);
    outgoing.send(Bytes::from_static(b"abc")).await.unwrap();
    let mut bytes = [0; 5];
    far.read_exact(&mut bytes).await.unwrap();
    assert_eq!(bytes, *b"\x00\x03abc");
}

#[tokio::test]
async fn both_framings_return_what_was_sent() {
    for websocket in [false, true] {
        let (near, far) = duplex(PIPE);
        let framed = async |stream, role| match websocket {
            true => by_message(WebSocketStream::from_raw_socket(stream, role, Some(websocket_config())).await),
            false => by_length(stream),
        };
        let (_, mut outgoing) = framed(near, Role::Client).await;
        let (mut incoming, _) = framed(far, Role::Server).await;
        for length in [1, 125, 126, 1472, MAX_DATAGRAM] {
            let sent = Bytes::from(vec![7; length]);
            outgoing.send(sent.clone()).await.unwrap();
            assert_eq!(incoming.next().await.unwrap().unwrap(), sent, "websocket: {websocket}");
        }
        drop(outgoing);
    }
}

#[tokio::test]
async fn a_length_above_the_maximum_ends_the_stream() {
    let (mut near, far) = duplex(PIPE);
    let (mut incoming, _outgoing) = by_length(far);
    let length = (MAX_DATAGRAM + 1) as u16;
    near.write_all(&length.to_be_bytes()).await.unwrap();
    assert!(incoming.next().await.unwrap().is_err());
}

#[tokio::test]
async fn a_half_datagram_is_an_error_at_the_end() {
    let (mut near, far) = duplex(PIPE);
    let (mut incoming, _outgoing) = by_length(far);
    near.write_all(b"\x00\x03a").await.unwrap();
    drop(near);
    assert!(incoming.next().await.unwrap().is_err());
}

#[tokio::test]
async fn a_websocket_takes_binary_messages_of_bounded_length_only() {
    for message in [Message::text("abc"), Message::binary(vec![0; MAX_DATAGRAM + 1])] {
        let (near, far) = duplex(PIPE);
        let mut client = WebSocketStream::from_raw_socket(near, Role::Client, None).await;
        let (mut incoming, _outgoing) =
            by_message(WebSocketStream::from_raw_socket(far, Role::Server, Some(websocket_config())).await);
        client.send(Message::Ping(Bytes::new())).await.unwrap();
        client.send(message).await.unwrap();
        assert!(incoming.next().await.unwrap().is_err());
    }
}
