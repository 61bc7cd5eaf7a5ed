//! The address of a listener, as users write it.

use std::net::{Ipv4Addr, SocketAddr};

use crate::error::HttpError;

/// Parses `HOST:PORT` with an IP address or `localhost`, or a port alone, which means loopback.
///
/// # Errors
///
/// Fails if the text is neither.
pub fn parse_address(text: &str) -> Result<SocketAddr, HttpError> {
    let port = text.strip_prefix("localhost:").or_else(|| text.strip_prefix(':')).unwrap_or(text);
    let on_loopback = port.parse().map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    on_loopback.or_else(|_| text.parse()).map_err(|_| HttpError::Address { text: text.chars().take(100).collect() })
}

#[cfg(test)]
#[path = "../tests/unit/address.rs"]
mod tests;
