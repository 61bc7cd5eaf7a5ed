//! Accepts the connections of other nodes to topics and services. The connection header names the
//! topic or service.

use std::sync::Arc;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::{Header, Stream, TcprosError};
use crate::connections::{accept, refused};

/// Maximum number of connections to all topics and services.
const MAX_CONNECTIONS: usize = 4096;

/// Maximum number of connections that have not sent their header yet.
const MAX_HANDSHAKES: usize = 256;

/// Timeout of the handshake.
const TIMEOUT: Duration = Duration::from_secs(10);

/// Accepts connections until it is dropped, which ends all of them. Calls `serve` with each
/// connection and its header.
pub async fn listen<F>(listener: TcpListener, serve: impl Fn(Stream, Header) -> F + Send + Sync + 'static)
where
    F: Future<Output = Result<(), TcprosError>> + Send + 'static,
{
    let serve = Arc::new(serve);
    let handshakes = Arc::new(Semaphore::new(MAX_HANDSHAKES));
    let mut connections = JoinSet::new();
    loop {
        let socket = accept(&listener, &mut connections, MAX_CONNECTIONS).await;
        let Ok(handshake) = handshakes.clone().try_acquire_owned() else {
            refused(&format!("{MAX_HANDSHAKES} others have not sent their header yet"));
            continue;
        };
        let serve = serve.clone();
        connections.spawn(async move {
            let begun = begin(socket).await;
            drop(handshake);
            let served = match begun {
                Ok((stream, header)) => serve(stream, header).await,
                Err(error) => Err(error),
            };
            if let Err(error) = served {
                tracing::debug!(%error, "a TCPROS connection ended");
            }
        });
    }
}

async fn begin(socket: TcpStream) -> Result<(Stream, Header), TcprosError> {
    let mut stream = Stream::new(socket)?;
    let header = timeout(TIMEOUT, stream.read_header()).await.map_err(|_| TcprosError::Timeout(TIMEOUT))??;
    Ok((stream, header))
}

/// Sends the reason of a refusal to the peer.
pub async fn refuse(mut stream: Stream, reason: &str) -> Result<(), TcprosError> {
    timeout(TIMEOUT, stream.write_header(&Header::new([("error", reason)])))
        .await
        .map_err(|_| TcprosError::Timeout(TIMEOUT))?
}
