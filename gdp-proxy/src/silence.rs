//! Finds out why no switch answers, as far as the network says: an unknown host name, or a port on
//! which nothing listens.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::time::Duration;

use gdp_core::link_target::LinkTarget;
use tokio::net::{UdpSocket, lookup_host};
use tokio::time::timeout;

/// Time to resolve a host name.
const RESOLVE: Duration = Duration::from_secs(2);

/// Time in which a host reports that a port is closed.
const REPORT: Duration = Duration::from_millis(500);

/// Returns the reason for the first of these links that has one.
pub async fn reason(links: impl Iterator<Item = &LinkTarget>) -> Option<String> {
    for link in links {
        if let LinkTarget::Udp { host, port, interface: None } = link
            && let Some(reason) = reason_of(host, *port).await
        {
            return Some(reason);
        }
    }
    None
}

async fn reason_of(host: &str, port: u16) -> Option<String> {
    match timeout(RESOLVE, lookup_host((host, port))).await {
        Ok(Ok(mut addresses)) => {
            let address = addresses.next()?;
            is_closed(address)
                .await
                .then(|| format!("nothing listens on UDP {address}; is that the address of a switch?"))
        }
        Ok(Err(error)) => Some(format!("the host {host} is not known ({error}); check the name, and DNS.")),
        Err(_) => Some(format!("no DNS server answers for {host}; check the network.")),
    }
}

/// Returns whether the host reports the port as closed. An empty datagram provokes the report, and
/// a switch ignores it.
async fn is_closed(address: SocketAddr) -> bool {
    let unspecified = if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let refused = async {
        let socket = UdpSocket::bind(unspecified).await?;
        socket.connect(address).await?;
        socket.send(&[]).await?;
        socket.recv(&mut [0; 1]).await.map(drop)
    };
    matches!(timeout(REPORT, refused).await, Ok(Err(error)) if error.kind() == ErrorKind::ConnectionRefused)
}
