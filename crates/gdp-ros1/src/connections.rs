//! Accepts connections for both servers of a node, and opens them, as far as open files suffice.

use std::io;
use std::time::{Duration, Instant};

use gdp_util::descriptors::{RESERVE, is_reserved};
use gdp_util::line_limit::LineLimit;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;

/// Limit on the warnings about connections that are not taken.
static WARNINGS: LineLimit = LineLimit::new(1, Duration::from_secs(60));

/// Returns the next connection if fewer than `max` are open. Closes further connections at once, so
/// that their peers notice and try again.
pub async fn accept(listener: &TcpListener, served: &mut JoinSet<()>, max: usize) -> TcpStream {
    loop {
        tokio::select! {
            // A connection that has ended frees its place.
            Some(_) = served.join_next() => {}
            accepted = listener.accept() => match accepted.and_then(|(stream, _)| spared(stream)) {
                Ok(stream) if served.len() < max => return stream,
                Ok(_) => refused(&format!("{max} are open, as many as are taken")),
                Err(error) => {
                    // The cause is the process (too many open files) or one peer. An immediate
                    // retry helps in neither case.
                    refused(&error.to_string());
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            },
        }
    }
}

/// Connects to a peer.
///
/// # Errors
///
/// Fails as [`TcpStream::connect`], and if only [`RESERVE`] files more can be opened.
pub async fn connect(host: &str, port: u16) -> io::Result<TcpStream> {
    let connected = TcpStream::connect((host, port)).await.and_then(spared);
    connected.inspect_err(|error| {
        if error.kind() == io::ErrorKind::QuotaExceeded {
            refused(&error.to_string());
        }
    })
}

/// Logs that a connection was not taken.
pub fn refused(why: &str) {
    if let Some(suppressed) = WARNINGS.take(Instant::now()) {
        tracing::warn!(suppressed, "a connection of ROS 1 is not taken: {why}");
    }
}

/// Closes a connection that took one of the reserved descriptors.
fn spared(stream: TcpStream) -> io::Result<TcpStream> {
    if !is_reserved(&stream) {
        return Ok(stream);
    }
    let why = format!(
        "this process may open {RESERVE} files more, which are for its links and files; raise its limit \
         (`LimitNOFILE=` of systemd, `ulimit -n`)"
    );
    Err(io::Error::new(io::ErrorKind::QuotaExceeded, why))
}
