//! Moves datagrams between a stream and a loopback socket.

use std::io;
use std::time::{Duration, Instant};

use bytes::BytesMut;
use futures::{SinkExt, StreamExt};
use parking_lot::Mutex;
use tokio::net::UdpSocket;
use tokio::sync::Notify;
use tokio::time::timeout;

use super::framing::{Incoming, MAX_DATAGRAM, Outgoing};
use super::queue::DatagramQueue;
use super::stream::UNSENT;

/// Time without a datagram of the peer, or without one for it, after which a tunnel ends. Links
/// send keep-alive packets each second.
const IDLE: Duration = Duration::from_secs(15);

/// Memory that datagrams are received into, in bytes.
const CHUNK: usize = 8 * MAX_DATAGRAM;

/// Runs a tunnel until the stream ends, an error occurs, or the peer is silent for too long. The
/// socket must be connected, so that no other program's datagrams arrive on it.
pub async fn run((mut incoming, mut outgoing): (Incoming, Outgoing), socket: UdpSocket) -> io::Result<()> {
    let (queue, queued) = (Mutex::new(DatagramQueue::default()), Notify::new());
    let answered = Mutex::new(Instant::now());
    let inward = async {
        let silent = || io::Error::new(io::ErrorKind::TimedOut, "one end of the tunnel is silent");
        let mut last = Instant::now();
        loop {
            // Empty datagrams do not keep a tunnel.
            let left = IDLE.saturating_sub(last.elapsed());
            match timeout(left, incoming.next()).await.map_err(|_| silent())? {
                Some(Ok(datagram)) if datagram.is_empty() => continue,
                Some(datagram) => pass_refused(socket.send(&datagram?).await)?,
                None => return Ok(()),
            };
            last = Instant::now();
            if answered.lock().elapsed() > IDLE {
                return Err(silent());
            }
        }
    };
    let receive = async {
        let mut chunk = BytesMut::with_capacity(CHUNK);
        loop {
            if chunk.capacity() < MAX_DATAGRAM {
                chunk = BytesMut::with_capacity(CHUNK);
            }
            if pass_refused(socket.recv_buf(&mut chunk).await)? > 0 {
                *answered.lock() = Instant::now();
                queue.lock().push(Instant::now(), chunk.split().freeze());
                queued.notify_one();
            }
        }
    };
    let outward = async {
        loop {
            let mut length = 0;
            while length < UNSENT as usize {
                let next = queue.lock().pop(Instant::now());
                let Some(datagram) = next else { break };
                length += datagram.len();
                outgoing.feed(datagram).await?;
            }
            match length {
                0 => queued.notified().await,
                _ => outgoing.flush().await?,
            }
        }
    };
    tokio::select! {
        ended = inward => ended,
        ended = receive => ended,
        ended = outward => ended,
    }
}

/// Ignores that nobody received an earlier datagram: the other side's port may open again.
fn pass_refused(result: io::Result<usize>) -> io::Result<usize> {
    match result {
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => Ok(0),
        result => result,
    }
}
