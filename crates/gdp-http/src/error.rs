//! Reasons why a listener does not start.

use std::net::SocketAddr;
use std::path::PathBuf;

/// Reasons why a listener does not start.
#[derive(Debug, thiserror::Error)]
pub enum HttpError {
    #[error("`{text}` is no address; write HOST:PORT with an IP address, or a port alone for 127.0.0.1")]
    Address { text: String },
    #[error("{addr} is reached by other machines; name a token file, or use an address of loopback such as 127.0.0.1")]
    NotLoopback { addr: SocketAddr },
    #[error("cannot listen on {addr}: {source}; choose another address, or stop the program that has it")]
    Bind { addr: SocketAddr, source: std::io::Error },
    #[error("cannot read the token file {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("every user of this machine may read the token file {}; run `chmod o= {}`", .0.display(), .0.display())]
    Exposed(PathBuf),
    #[error(
        "the token file {} has no token of 16 to 256 letters, digits, dots, hyphens, tildes and underscores; write one \
         with `openssl rand -hex 32`", .0.display()
    )]
    Token(PathBuf),
}
