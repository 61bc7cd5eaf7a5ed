//! Errors of links: a link could not be made, or a request on it failed.

use crate::link::close_code::CloseCode;
use crate::link::timing::IDLE_TIMEOUT;
use crate::link::version::Versions;

use gdp_proto::control::CodecError;
use gdp_wire::Name;
use quinn::TransportErrorCode;
use std::io;
use std::time::Duration;

/// The reason why a link could not be made or a request on it failed.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    #[error("{what}: {source}")]
    Io { what: String, source: io::Error },
    #[error("the link could not be made: {0}")]
    Handshake(String),
    #[error("{what} took longer than {} s", .after.as_secs())]
    Timeout { what: &'static str, after: Duration },
    #[error("the peer is {found:#}, not {expected:#}; check the address, or the name that is configured for it")]
    WrongPeer { expected: Name, found: Name },
    #[error(
        "the peer speaks no version above gdp/{theirs}, and this side speaks gdp/{oldest} to gdp/{newest} only; \
         upgrade the peer"
    )]
    OldVersion { theirs: u8, oldest: u8, newest: u8 },
    #[error("all {} link ids are in use", gdp_wire::table::MAX_LINKS)]
    NoFreeId,
    #[error("the link is closed: {0}")]
    Closed(String),
    #[error("the peer reset the link and gave no reason")]
    Reset,
    #[error(transparent)]
    Codec(#[from] CodecError),
    #[error("the peer broke the protocol: {0}")]
    Protocol(String),
}

impl LinkError {
    /// Returns the code and the reason with which this side refuses a link during the exchange of
    /// hellos. `None` if the connection has ended already.
    pub(super) fn refusal(&self) -> Option<(CloseCode, String)> {
        match self {
            Self::WrongPeer { .. } => Some((CloseCode::WrongPeer, "another peer was expected".into())),
            Self::NoFreeId => Some((CloseCode::Full, self.to_string())),
            Self::Codec(error) => Some((CloseCode::Malformed, error.to_string())),
            Self::Protocol(reason) | Self::Handshake(reason) => Some((CloseCode::Malformed, reason.clone())),
            Self::Timeout { .. } => Some((CloseCode::Timeout, self.to_string())),
            Self::OldVersion { .. } | Self::Closed(_) | Self::Reset | Self::Io { .. } => None,
        }
    }
}

impl From<quinn::ConnectionError> for LinkError {
    fn from(error: quinn::ConnectionError) -> Self {
        match error {
            quinn::ConnectionError::Reset => Self::Reset,
            error => Self::Closed(close_reason(&error)),
        }
    }
}

/// Maximum number of characters of a peer's close reason in messages.
pub const MAX_REASON: usize = 600;

/// TLS's alert (RFC 7301) if one side offers no version that the other one knows.
const NO_APPLICATION_PROTOCOL: u8 = 120;

fn no_common_version() -> String {
    let Versions { oldest, newest } = Versions::SPOKEN;
    format!("no version in common: this side speaks gdp/{oldest} to gdp/{newest}; upgrade the older of the two")
}

/// Describes why a connection closed, for a person. The peer's own text is bounded and escaped.
pub fn close_reason(error: &quinn::ConnectionError) -> String {
    let no_protocol = TransportErrorCode::crypto(NO_APPLICATION_PROTOCOL);
    match error {
        quinn::ConnectionError::ApplicationClosed(close) => {
            let words: String = String::from_utf8_lossy(&close.reason).chars().take(MAX_REASON).collect();
            if words.is_empty() {
                "closed by the peer".into()
            } else {
                format!("closed by the peer: {}", words.escape_debug())
            }
        }
        quinn::ConnectionError::TimedOut => format!("nothing heard for {} s", IDLE_TIMEOUT.as_secs()),
        quinn::ConnectionError::TransportError(error) if error.code == no_protocol => no_common_version(),
        quinn::ConnectionError::ConnectionClosed(close) if close.error_code == no_protocol => no_common_version(),
        quinn::ConnectionError::LocallyClosed => "closed on this side".into(),
        other => other.to_string(),
    }
}
