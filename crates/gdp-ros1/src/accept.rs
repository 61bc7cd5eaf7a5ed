//! Accepts connections, for both servers of a node.

use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;

/// The next connection while fewer than `max` are served; others are closed at once, so that their
/// peers see it and try again.
pub async fn accept(listener: &TcpListener, served: &mut JoinSet<()>, max: usize) -> TcpStream {
    loop {
        tokio::select! {
            // What has ended gives its place back.
            Some(_) = served.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) if served.len() < max => return stream,
                Ok((_, peer)) => tracing::warn!(%peer, max, "connection refused: as many as are taken are open"),
                Err(error) => {
                    // Of the process (too many files) or of one peer: neither is better if it is
                    // tried at once.
                    tracing::warn!(%error, "cannot take a connection");
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            },
        }
    }
}
