//! One XML-RPC call on its own connection, with a timeout and a maximum size of the response.

use std::io;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Full, Limited};
use hyper::client::conn::http1;
use hyper::{Request, StatusCode, Uri, header};
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::connections;
use crate::xmlrpc::{Call, Fault, Mismatch, Value, XmlRpcError, decode_response, encode_call};

/// Maximum size of a response, in bytes. A graph of ten thousand topics takes about two million.
const MAX_ANSWER: usize = 16 << 20;

/// The reason why a call failed.
#[derive(Debug, thiserror::Error)]
pub enum RpcError {
    #[error("{0:?} is not a URI of the form http://HOST:PORT/")]
    Uri(String),
    #[error("no connection: {0}")]
    Connect(io::Error),
    #[error("no answer within {0:?}")]
    Timeout(Duration),
    #[error("HTTP: {0}")]
    Http(#[from] hyper::Error),
    #[error("HTTP status {0}")]
    Status(StatusCode),
    #[error("the answer cannot be read, or has more than {MAX_ANSWER} bytes: {0}")]
    Body(Box<dyn std::error::Error + Send + Sync>),
    #[error("the answer is not XML-RPC as ROS uses it: {0}")]
    XmlRpc(#[from] XmlRpcError),
    #[error("the answer is not what the ROS API says: {0}")]
    Mismatch(#[from] Mismatch),
    #[error("{0}")]
    Fault(#[from] Fault),
    /// The text of a response whose status code is not 1.
    #[error("refused: {0}")]
    Refused(String),
}

/// What is called. The master is called also if few more files can be opened.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Callee {
    Master,
    Node,
}

/// Calls a method of the master or slave API at `uri`. Returns the third part of the response
/// (code, text, value).
pub async fn call(
    callee: Callee,
    uri: &str,
    method: &str,
    params: impl IntoIterator<Item = Value>,
    limit: Duration,
) -> Result<Value, RpcError> {
    let call = Call { method: method.to_owned(), params: params.into_iter().collect() };
    let answer =
        timeout(limit, exchange(callee, uri, encode_call(&call))).await.map_err(|_| RpcError::Timeout(limit))??;
    let [code, text, value] = decode_response(&answer)??.into_tuple()?;
    if code.into_int()? != 1 {
        return Err(RpcError::Refused(text.into_string()?));
    }
    Ok(value)
}

async fn exchange(callee: Callee, uri: &str, body: String) -> Result<Bytes, RpcError> {
    let bad = || RpcError::Uri(uri.to_owned());
    let parsed: Uri = uri.parse().map_err(|_| bad())?;
    let (host, port) = host_and_port(&parsed).ok_or_else(bad)?;
    let stream = match callee {
        Callee::Master => TcpStream::connect((host, port)).await,
        Callee::Node => connections::connect(host, port).await,
    };
    let stream = stream.map_err(RpcError::Connect)?;
    // Each side sends one small write, so a delay saves nothing. If the option cannot be set, only
    // time is lost.
    _ = stream.set_nodelay(true);
    // Some small servers of ROS accept `Content-Length` but not `content-length`.
    let (mut sender, connection) =
        http1::Builder::new().title_case_headers(true).handshake(TokioIo::new(stream)).await?;
    let request = Request::post(parsed.path_and_query().map_or("/", |path| path.as_str()))
        .header(header::HOST, parsed.authority().map_or("", |authority| authority.as_str()))
        .header(header::CONTENT_TYPE, "text/xml")
        .header(header::CONNECTION, "close")
        .body(Full::new(Bytes::from(body)))
        .map_err(|_| bad())?;
    let answer = async {
        let response = sender.send_request(request).await?;
        if response.status() != StatusCode::OK {
            return Err(RpcError::Status(response.status()));
        }
        Ok(Limited::new(response.into_body(), MAX_ANSWER).collect().await.map_err(RpcError::Body)?.to_bytes())
    };
    tokio::pin!(answer, connection);
    // The connection must be polled. It may end before the response has been read.
    tokio::select! {
        answer = &mut answer => answer,
        ended = &mut connection => match ended {
            Ok(()) => answer.await,
            Err(error) => Err(error.into()),
        },
    }
}

/// Returns the host and port of `http://HOST:PORT/` or `rosrpc://HOST:PORT`. Removes the brackets
/// of an IPv6 address.
pub fn host_and_port(uri: &Uri) -> Option<(&str, u16)> {
    let host = uri.host()?;
    let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    if !matches!(uri.scheme_str(), Some("http" | "rosrpc")) {
        return None;
    }
    Some((host, uri.port_u16()?))
}

#[cfg(test)]
#[path = "../../tests/unit/api/client.rs"]
mod tests;
