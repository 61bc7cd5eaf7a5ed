//! A talker or listener over QUIC (quinn), as a measure for what QUIC carries. See README.md.
//!
//! Each topic has a stream with length-prefixed messages. With `--stream-each`, each message has a
//! stream of its own instead.

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use quinn::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use quinn::{ClientConfig, Connection, Endpoint, RecvStream, SendStream, ServerConfig};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use serde_json::json;

#[derive(Parser)]
struct Arguments {
    #[arg(value_enum)]
    verb: Verb,
    /// The listener's address. The listener listens at every address.
    #[arg(long, default_value_t = Ipv4Addr::UNSPECIFIED.into())]
    peer: IpAddr,
    /// The listener's private key, PEM.
    #[arg(long)]
    key: PathBuf,
    /// The certificate of that key, which the talker trusts, PEM.
    #[arg(long)]
    certificate: PathBuf,
    /// Ignored: QUIC drops nothing.
    #[arg(long)]
    depth: Option<u32>,
    /// Number of messages; 0: until killed.
    #[arg(long, default_value_t = 0)]
    count: u64,
    /// Messages per second.
    #[arg(long, default_value_t = 10.0)]
    rate: f64,
    /// Bytes of a message.
    #[arg(long, default_value_t = 64)]
    size: usize,
    /// Ignored: the filler is the same byte throughout.
    #[arg(long)]
    text: Option<String>,
    /// Number of topics, used in turn.
    #[arg(long, default_value_t = 1)]
    topics: u8,
    /// Send warm-up messages, numbered -1, until this file exists.
    #[arg(long)]
    gate: Option<PathBuf>,
    /// Send each message on a stream of its own.
    #[arg(long)]
    stream_each: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Verb {
    Talk,
    Listen,
}

const PORT: u16 = 7449;

/// Bytes before the filler: topic, sequence number and clock.
const HEAD: usize = 17;

/// Bytes of the largest message.
const MAX_MESSAGE: usize = 1 << 24;

const FILLER: u8 = b'x';

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<()> {
    let arguments = Arguments::parse();
    match arguments.verb {
        Verb::Talk => talk(&arguments).await,
        Verb::Listen => listen(&arguments).await,
    }
}

async fn talk(arguments: &Arguments) -> Result<()> {
    let mut roots = rustls::RootCertStore::empty();
    roots.add(certificate(arguments)?)?;
    let crypto = rustls::ClientConfig::builder_with_protocol_versions(&[&rustls::version::TLS13])
        .with_root_certificates(roots)
        .with_no_client_auth();
    let mut endpoint = Endpoint::client((Ipv4Addr::UNSPECIFIED, 0).into())?;
    endpoint.set_default_client_config(ClientConfig::new(Arc::new(QuicClientConfig::try_from(crypto)?)));
    let to = SocketAddr::from((arguments.peer, PORT));
    let connection = endpoint.connect(to, &arguments.peer.to_string())?.await?;
    say(json!({"event": "matched"}));
    let mut sender = Sender::open(connection, arguments).await?;
    let every = Duration::from_secs_f64(1.0 / arguments.rate);
    while arguments.gate.as_ref().is_some_and(|gate| !gate.exists()) {
        for topic in 0..arguments.topics {
            sender.send(topic, -1).await?;
        }
        tokio::time::sleep(every).await;
    }
    let start = Instant::now();
    let mut sequence = 0;
    while arguments.count == 0 || sequence < arguments.count {
        let due = start + Duration::from_secs_f64(sequence as f64 / arguments.rate);
        if due > Instant::now() {
            tokio::time::sleep_until(due.into()).await;
        }
        sender.send((sequence % u64::from(arguments.topics)) as u8, sequence as i64).await?;
        sequence += 1;
    }
    say(json!({"event": "done", "sent": sequence}));
    std::future::pending().await
}

/// The sending end, with a stream for each topic or for each message.
struct Sender {
    connection: Connection,
    streams: Vec<SendStream>,
    message: Vec<u8>,
}

impl Sender {
    async fn open(connection: Connection, arguments: &Arguments) -> Result<Self> {
        let mut streams = Vec::new();
        for _ in 0..if arguments.stream_each { 0 } else { arguments.topics } {
            streams.push(connection.open_uni().await?);
        }
        let length = arguments.size.max(HEAD);
        let mut message = (length as u32).to_be_bytes().to_vec();
        message.resize(size_of::<u32>() + length, FILLER);
        Ok(Self { connection, streams, message })
    }

    async fn send(&mut self, topic: u8, sequence: i64) -> Result<()> {
        let head = &mut self.message[size_of::<u32>()..][..HEAD];
        head[0] = topic;
        head[1..9].copy_from_slice(&sequence.to_be_bytes());
        head[9..].copy_from_slice(&clock().to_be_bytes());
        match self.streams.get_mut(usize::from(topic)) {
            Some(stream) => stream.write_all(&self.message).await?,
            None => {
                let mut stream = self.connection.open_uni().await?;
                stream.write_all(&self.message).await?;
                stream.finish()?;
            }
        }
        Ok(())
    }
}

async fn listen(arguments: &Arguments) -> Result<()> {
    let key = PrivateKeyDer::from_pem_file(&arguments.key).context("the key")?;
    let crypto = rustls::ServerConfig::builder_with_protocol_versions(&[&rustls::version::TLS13])
        .with_no_client_auth()
        .with_single_cert(vec![certificate(arguments)?], key)?;
    let config = ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(crypto)?));
    let endpoint = Endpoint::server(config, (Ipv4Addr::UNSPECIFIED, PORT).into())?;
    say(json!({"event": "ready"}));
    let connection = endpoint.accept().await.context("the endpoint is closed")?.await?;
    while let Ok(stream) = connection.accept_uni().await {
        tokio::spawn(async move {
            if let Err(error) = receive(stream).await {
                eprintln!("{error:#}");
            }
        });
    }
    std::future::pending().await
}

/// Reports the messages of a stream until it ends.
async fn receive(mut stream: RecvStream) -> Result<()> {
    let (mut length, mut message) = ([0; 4], Vec::new());
    while stream.read_exact(&mut length).await.is_ok() {
        let length = u32::from_be_bytes(length) as usize;
        ensure!((HEAD..=MAX_MESSAGE).contains(&length), "a message of {length} bytes");
        message.resize(length, 0);
        stream.read_exact(&mut message).await?;
        let now = clock();
        let number = |at: usize| message[at..].first_chunk().map_or(0, |bytes| i64::from_be_bytes(*bytes));
        let intact = message[HEAD..].iter().all(|byte| *byte == FILLER);
        say(json!({
            "event": "message", "topic": message[0], "seq": number(1), "latency_ns": now - number(9), "bytes": length,
            "intact": intact,
        }));
    }
    Ok(())
}

fn certificate(arguments: &Arguments) -> Result<CertificateDer<'static>> {
    CertificateDer::from_pem_file(&arguments.certificate).context("the certificate")
}

/// Returns CLOCK_MONOTONIC in nanoseconds, which all network namespaces of a machine share.
fn clock() -> i64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: a pointer to a live timespec.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &mut time) };
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}

fn say(line: serde_json::Value) {
    let mut out = std::io::stdout().lock();
    // The reader may have ended, and then ends this program.
    _ = writeln!(out, "{line}").and_then(|()| out.flush());
}
