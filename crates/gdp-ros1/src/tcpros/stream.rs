//! One TCPROS connection: the handshake, and messages in both directions.

use std::io;
use std::time::Duration;

use bytes::{Buf, Bytes, BytesMut};
use socket2::{SockRef, TcpKeepalive};
use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};

use super::header::{Header, HeaderError, MAX_HEADER};
use crate::connections;

/// Size of the read buffer, in bytes. Larger reads go directly to the message.
const READ: usize = 64 << 10;

/// Maximum memory that is allocated before the bytes of a message arrive. It then doubles as
/// needed.
const FIRST: usize = 1 << 20;

/// TCP keepalive. It detects a vanished peer after 60 + 9 × 10 seconds, as with rospy.
const KEEPALIVE: TcpKeepalive =
    TcpKeepalive::new().with_time(Duration::from_secs(60)).with_interval(Duration::from_secs(10)).with_retries(9);

/// The reason why a connection has failed.
#[derive(Debug, thiserror::Error)]
pub enum TcprosError {
    #[error("the connection broke: {0}")]
    Io(#[from] io::Error),
    #[error("the peer closed the connection")]
    Closed,
    #[error("no connection header: {0}")]
    Header(#[from] HeaderError),
    /// The field `error` of the peer's header.
    #[error("the peer refuses: {0}")]
    Refused(String),
    #[error("the peer's header has no field {0:?}")]
    Missing(&'static str),
    #[error("the peer's {field} is {theirs:?} and not {ours:?}")]
    Differs { field: &'static str, theirs: String, ours: String },
    #[error("a message of {length} bytes, and at most {max} are taken: raise `max_message` if it was meant")]
    TooLong { length: usize, max: usize },
    #[error("not finished within {0:?}")]
    Timeout(Duration),
}

/// A TCPROS connection.
pub struct Stream {
    pub reader: BufReader<OwnedReadHalf>,
    pub writer: OwnedWriteHalf,
}

impl Stream {
    /// Wraps a connected socket.
    pub fn new(socket: TcpStream) -> io::Result<Self> {
        socket.set_nodelay(true)?;
        SockRef::from(&socket).set_tcp_keepalive(&KEEPALIVE)?;
        let (reader, writer) = socket.into_split();
        Ok(Self { reader: BufReader::with_capacity(READ, reader), writer })
    }

    pub async fn connect(host: &str, port: u16) -> io::Result<Self> {
        Self::new(connections::connect(host, port).await?)
    }

    pub async fn read_header(&mut self) -> Result<Header, TcprosError> {
        let length = self.reader.read_u32_le().await.map_err(closed)?;
        if length as usize > MAX_HEADER {
            return Err(HeaderError::TooLong(length).into());
        }
        let bytes = read_bytes(&mut self.reader, length as usize).await?;
        Ok(Header::decode(&bytes)?)
    }

    pub async fn write_header(&mut self, header: &Header) -> Result<(), TcprosError> {
        Ok(self.writer.write_all(&header.encode()).await?)
    }

    /// Does the client's side of the handshake. Sends `header`, and returns the peer's header
    /// unless that is an error.
    pub async fn greet(&mut self, header: &Header) -> Result<Header, TcprosError> {
        self.write_header(header).await?;
        let theirs = self.read_header().await?;
        match theirs.get("error") {
            Some(error) => Err(TcprosError::Refused(error.chars().take(1000).collect())),
            None => Ok(theirs),
        }
    }

    pub async fn read_message(&mut self, max: usize) -> Result<Bytes, TcprosError> {
        let length = self.reader.read_u32_le().await.map_err(closed)?;
        let length = length as usize;
        if length > max {
            return Err(TcprosError::TooLong { length, max });
        }
        read_bytes(&mut self.reader, length).await
    }

    pub async fn write_message(&mut self, message: &Bytes) -> Result<(), TcprosError> {
        write_message(&mut self.writer, message).await
    }
}

/// Writes a message of at most 4 GiB with its length prefix.
pub async fn write_message(writer: &mut OwnedWriteHalf, message: &Bytes) -> Result<(), TcprosError> {
    let too_long = |_| TcprosError::TooLong { length: message.len(), max: u32::MAX as usize };
    let length = u32::try_from(message.len()).map_err(too_long)?.to_le_bytes();
    Ok(writer.write_all_buf(&mut Buf::chain(&length[..], &message[..])).await?)
}

/// Reads `length` bytes. Memory grows with the bytes received, not with the length announced.
async fn read_bytes(reader: &mut BufReader<OwnedReadHalf>, length: usize) -> Result<Bytes, TcprosError> {
    let mut bytes = BytesMut::with_capacity(length.min(FIRST));
    while bytes.len() < length {
        let missing = length - bytes.len();
        if bytes.capacity() == bytes.len() {
            bytes.reserve(missing.min(bytes.len()));
        }
        if reader.take(missing as u64).read_buf(&mut bytes).await? == 0 {
            return Err(TcprosError::Closed);
        }
    }
    Ok(bytes.freeze())
}

fn closed(error: io::Error) -> TcprosError {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => TcprosError::Closed,
        _ => error.into(),
    }
}
