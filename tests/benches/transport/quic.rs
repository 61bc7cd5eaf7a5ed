//! QUIC (quinn): one connection, a stream per lane, consecutive messages on it.

use std::net::SocketAddr;
use std::sync::Arc;

use anyhow::{Context, Result};
use quinn::congestion::BbrConfig;
use quinn::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use quinn::{ClientConfig, Endpoint, RecvStream, SendStream, ServerConfig, TransportConfig};

use crate::lane::{self, Lane, Sender};
use crate::run::Carrier;
use crate::site::Ends;
use crate::tls;

/// quinn's default congestion controller.
pub const CUBIC: &str = "quinn";

/// The congestion controller that does not treat loss as congestion. quinn calls its implementation
/// experimental.
pub const BBR: &str = "quinn (BBR)";

const PORT: u16 = 4433;

pub fn cubic(ends: &Ends, lanes: &[Arc<Lane>]) -> Result<Carrier> {
    open(ends, lanes, TransportConfig::default())
}

pub fn bbr(ends: &Ends, lanes: &[Arc<Lane>]) -> Result<Carrier> {
    let mut transport = TransportConfig::default();
    transport.congestion_controller_factory(Arc::new(BbrConfig::default()));
    open(ends, lanes, transport)
}

fn open(ends: &Ends, lanes: &[Arc<Lane>], transport: TransportConfig) -> Result<Carrier> {
    let (server, client) = tls::configs()?;
    let server = ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(server)?));
    let mut client = ClientConfig::new(Arc::new(QuicClientConfig::try_from(client)?));
    client.transport_config(Arc::new(transport));
    let address = SocketAddr::from((ends.cloud.address, PORT));
    let listening = ends.cloud.inside.run(async move { Endpoint::server(server, address) })??;
    ends.cloud.inside.runtime.spawn(accept(listening, lanes.to_vec()));
    let from = SocketAddr::from((ends.robot.address, 0));
    let connect = async move {
        let mut endpoint = Endpoint::client(from)?;
        endpoint.set_default_client_config(client);
        let connection = endpoint.connect(address, tls::CLOUD)?.await?;
        anyhow::Ok((endpoint, connection))
    };
    let (endpoint, connection) = ends.robot.inside.run(connect)??;
    for (index, lane) in lanes.iter().enumerate() {
        let (connection, lane) = (connection.clone(), lane.clone());
        ends.robot.inside.runtime.spawn(async move {
            let opened = async {
                let mut stream = connection.open_uni().await?;
                stream.write_all(&[index as u8]).await?;
                anyhow::Ok(Quic(stream))
            };
            match opened.await {
                Ok(stream) => lane.feed(stream).await,
                Err(error) => lane.note(Err(error)),
            }
        });
    }
    Ok(Carrier::closed_by(async move {
        endpoint.close(0u32.into(), b"");
        endpoint.wait_idle().await;
    }))
}

async fn accept(endpoint: Endpoint, lanes: Vec<Arc<Lane>>) -> Result<()> {
    let connection = endpoint.accept().await.context("an endpoint that is open")?.await?;
    loop {
        let stream = connection.accept_uni().await?;
        tokio::spawn(receive(stream, lanes.clone()));
    }
}

async fn receive(mut stream: RecvStream, lanes: Vec<Arc<Lane>>) -> Result<()> {
    let lane = lane::of(&lanes, &mut stream).await?;
    lane.note(lane::drain(lane, stream).await);
    Ok(())
}

struct Quic(SendStream);

impl Sender for Quic {
    async fn send(&mut self, body: &[u8]) -> Result<()> {
        Ok(self.0.write_all(body).await?)
    }
}
