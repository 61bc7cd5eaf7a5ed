//! The reasons why a daemon does not start.

use std::net::SocketAddr;
use std::path::PathBuf;

use gdp_core::secret_file::SecretFileError;
use gdp_dataplane::PlaneError;
use gdp_http::HttpError;
use gdp_link::link::LinkError;
use gdp_util::line_socket::SocketError;

use super::domain_store::MembershipError;
use crate::store::StoreError;

/// The reason why a daemon does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    #[error(transparent)]
    Identity(#[from] SecretFileError),
    #[error(transparent)]
    Membership(#[from] MembershipError),
    #[error("cannot create the folder {}: {source}", path.display())]
    Folder { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Plane(#[from] PlaneError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error("cannot ask the kernel for its interfaces: {0}")]
    Netlink(#[from] rtnetlink::Error),
    #[error(
        "this daemon has no interface and no UDP address, so nobody can reach it; name interfaces, or set udp: \
         0.0.0.0:31415"
    )]
    NoPort,
    #[error("UDP {addr} is used by {owner}; stop it, or choose another port with --udp or `udp:`")]
    PortTaken { addr: SocketAddr, owner: String },
    #[error("cannot listen for TLS on TCP {addr}: {source}; choose another address or port with `tls:`")]
    Tls { addr: SocketAddr, source: std::io::Error },
    #[error(transparent)]
    Admin(#[from] SocketError),
    #[error("metrics: {0}")]
    Metrics(#[from] HttpError),
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl StartError {
    /// Returns whether an interface is missing or down.
    pub(super) fn is_absent(&self) -> bool {
        matches!(self.os_error(), Some(libc::ENODEV | libc::ENETDOWN))
    }

    pub(super) fn is_denied(&self) -> bool {
        matches!(self.os_error(), Some(libc::EPERM | libc::EACCES))
    }

    fn os_error(&self) -> Option<i32> {
        let Self::Link(LinkError::Io { source, .. }) = self else { return None };
        source.raw_os_error()
    }
}
