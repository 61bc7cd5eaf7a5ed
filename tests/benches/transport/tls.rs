//! TLS 1.3 over TCP (rustls, tokio): a connection per lane, consecutive messages on it.

use std::net::SocketAddr;
use std::os::fd::AsRawFd;
use std::sync::Arc;

use anyhow::{Result, ensure};
use rustls::pki_types::{PrivatePkcs8KeyDer, ServerName};
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::{TlsAcceptor, TlsConnector};

use crate::lane::{self, Lane, Sender};
use crate::run::Carrier;
use crate::site::Ends;

/// Linux's default congestion controller.
pub const CUBIC: &str = "TCP + TLS";

/// The congestion controller that does not treat loss as congestion.
pub const BBR: &str = "TCP (BBR) + TLS";

/// The name in the cloud's certificate, here and over QUIC.
pub const CLOUD: &str = "cloud";

const PORT: u16 = 4443;

pub fn cubic(ends: &Ends, lanes: &[Arc<Lane>]) -> Result<Carrier> {
    open(ends, lanes, "cubic")
}

pub fn bbr(ends: &Ends, lanes: &[Arc<Lane>]) -> Result<Carrier> {
    open(ends, lanes, "bbr")
}

fn open(ends: &Ends, lanes: &[Arc<Lane>], congestion: &'static str) -> Result<Carrier> {
    let (server, client) = configs()?;
    let (acceptor, connector) = (TlsAcceptor::from(Arc::new(server)), TlsConnector::from(Arc::new(client)));
    let address = SocketAddr::from((ends.cloud.address, PORT));
    let listener = ends.cloud.inside.run(TcpListener::bind(address))??;
    let accepting = lanes.to_vec();
    ends.cloud.inside.runtime.spawn(async move {
        while let Ok((stream, _)) = listener.accept().await {
            tokio::spawn(receive(acceptor.clone(), stream, accepting.clone()));
        }
    });
    for (index, lane) in lanes.iter().enumerate() {
        let connector = connector.clone();
        let connect = async move {
            let stream = TcpStream::connect(address).await?;
            stream.set_nodelay(true)?;
            control(&stream, congestion)?;
            let mut stream = connector.connect(ServerName::try_from(CLOUD)?, stream).await?;
            stream.write_u8(index as u8).await?;
            anyhow::Ok(Tls(stream))
        };
        let stream = ends.robot.inside.run(connect)??;
        ends.robot.inside.runtime.spawn(lane.clone().feed(stream));
    }
    // Dropping the sockets closes them.
    Ok(Carrier::closed_by(async {}))
}

/// Sets the congestion controller.
fn control(stream: &TcpStream, congestion: &str) -> Result<()> {
    let (fd, name, length) = (stream.as_raw_fd(), congestion.as_ptr().cast(), congestion.len() as u32);
    // SAFETY: pointer and length are of one live string.
    let result = unsafe { libc::setsockopt(fd, libc::IPPROTO_TCP, libc::TCP_CONGESTION, name, length) };
    let error = std::io::Error::last_os_error();
    ensure!(result == 0, "no congestion controller {congestion}: {error}; `modprobe tcp_{congestion}`");
    Ok(())
}

/// Returns the configurations of both sides, with a new key.
pub fn configs() -> Result<(rustls::ServerConfig, rustls::ClientConfig)> {
    let certified = rcgen::generate_simple_self_signed([CLOUD.to_owned()])?;
    let (certificate, key) = (certified.cert.der().clone(), certified.signing_key.serialize_der());
    let mut roots = rustls::RootCertStore::empty();
    roots.add(certificate.clone())?;
    let server = rustls::ServerConfig::builder_with_protocol_versions(&[&rustls::version::TLS13])
        .with_no_client_auth()
        .with_single_cert(vec![certificate], PrivatePkcs8KeyDer::from(key).into())?;
    let client = rustls::ClientConfig::builder_with_protocol_versions(&[&rustls::version::TLS13])
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok((server, client))
}

async fn receive(acceptor: TlsAcceptor, stream: TcpStream, lanes: Vec<Arc<Lane>>) -> Result<()> {
    let mut stream = acceptor.accept(stream).await?;
    let lane = lane::of(&lanes, &mut stream).await?;
    lane.note(lane::drain(lane, stream).await);
    Ok(())
}

struct Tls(tokio_rustls::client::TlsStream<TcpStream>);

impl Sender for Tls {
    async fn send(&mut self, body: &[u8]) -> Result<()> {
        self.0.write_all(body).await?;
        Ok(self.0.flush().await?)
    }
}
