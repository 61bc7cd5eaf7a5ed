//! Accepts connections for both servers of a node.

use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;

/// Returns the next connection if fewer than `max` are open. Closes further connections at once, so
/// that their peers notice and try again.
pub async fn accept(listener: &TcpListener, served: &mut JoinSet<()>, max: usize) -> TcpStream {
    loop {
        tokio::select! {
            // A connection that has ended frees its place.
            Some(_) = served.join_next() => {}
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) if served.len() < max => return stream,
                Ok((_, peer)) => tracing::warn!(%peer, max, "connection refused: as many as are taken are open"),
                Err(error) => {
                    // The cause is the process (too many open files) or one peer. An immediate
                    // retry helps in neither case.
                    tracing::warn!(%error, "cannot take a connection");
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            },
        }
    }
}
