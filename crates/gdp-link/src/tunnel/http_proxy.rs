//! Passes an HTTP proxy by `CONNECT` (RFC 9110, section 9.3.6). `HTTPS_PROXY` and `ALL_PROXY` name
//! the proxy, and `NO_PROXY` the exceptions, as for other programs.

use std::fmt;

use bytes::Bytes;
use http_body_util::Empty;
use hyper::client::conn::http1;
use hyper::header::{HOST, HeaderValue, PROXY_AUTHORIZATION};
use hyper::{Request, StatusCode, Uri};
use hyper_util::client::proxy::matcher::Matcher;
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncRead, AsyncWrite};

/// Maximum size of the proxy's answer in bytes. hyper permits no less.
const MAX_ANSWER: usize = 8 << 10;

/// An HTTP proxy.
#[derive(Clone)]
pub struct HttpProxy {
    pub host: String,
    pub port: u16,
    /// User and password in the form of the header. A secret.
    authorization: Option<HeaderValue>,
}

/// The reason why a proxy does not let a connection pass.
#[derive(Debug, thiserror::Error)]
pub enum HttpProxyError {
    #[error("it refuses CONNECT to {to} with {status}; have that address allowed there, or except it with NO_PROXY")]
    Refused { to: String, status: StatusCode },
    #[error("it wants a user and a password: set HTTPS_PROXY=http://USER:PASSWORD@HOST:PORT")]
    Unauthorized,
    #[error("only proxies of the form http://HOST:PORT can be used; correct HTTPS_PROXY")]
    Scheme,
    #[error("it does not speak HTTP as a proxy does: {0}")]
    Http(#[from] hyper::Error),
    #[error("{0} is no address for CONNECT")]
    Address(String),
    #[error("it sends data before the connection is used")]
    EarlyData,
}

impl HttpProxy {
    /// Returns the proxy for an address in the form `HOST:PORT`, if one is configured.
    pub fn of(matcher: &Matcher, to: &str) -> Result<Option<Self>, HttpProxyError> {
        let uri: Uri = format!("https://{to}/").parse().map_err(|_| HttpProxyError::Address(to.into()))?;
        let Some(found) = matcher.intercept(&uri) else { return Ok(None) };
        let proxy = found.uri();
        let (Some("http"), Some(host)) = (proxy.scheme_str(), proxy.host()) else {
            return Err(HttpProxyError::Scheme);
        };
        let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        let authorization = found.basic_auth().cloned();
        Ok(Some(Self { host, port: proxy.port_u16().unwrap_or(80), authorization }))
    }

    /// Asks the proxy at the other end of `stream` for a connection to `to`, and returns the
    /// stream, which then leads there.
    pub async fn connect<S>(&self, stream: S, to: &str) -> Result<S, HttpProxyError>
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let address = || HttpProxyError::Address(to.into());
        let mut request = Request::connect(to).body(Empty::<Bytes>::new()).map_err(|_| address())?;
        let host = HeaderValue::from_str(to).map_err(|_| address())?;
        request.headers_mut().insert(HOST, host);
        if let Some(authorization) = &self.authorization {
            request.headers_mut().insert(PROXY_AUTHORIZATION, authorization.clone());
        }
        let (mut sender, connection) =
            http1::Builder::new().max_buf_size(MAX_ANSWER).handshake(TokioIo::new(stream)).await?;
        let asked = async {
            let answer = sender.send_request(request).await?;
            match answer.status() {
                status if status.is_success() => Ok(hyper::upgrade::on(answer).await?),
                StatusCode::PROXY_AUTHENTICATION_REQUIRED => Err(HttpProxyError::Unauthorized),
                status => Err(HttpProxyError::Refused { to: to.into(), status }),
            }
        };
        let connection = connection.with_upgrades();
        tokio::pin!(asked);
        let upgraded = tokio::select! {
            upgraded = &mut asked => upgraded,
            // It ends when the connection is upgraded, or failed.
            _ = connection => asked.await,
        }?;
        let parts = upgraded.downcast::<TokioIo<S>>().map_err(|_| HttpProxyError::EarlyData)?;
        match parts.read_buf.is_empty() {
            true => Ok(parts.io.into_inner()),
            false => Err(HttpProxyError::EarlyData),
        }
    }
}

impl fmt::Display for HttpProxy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.host.contains(':') {
            true => write!(f, "http://[{}]:{}", self.host, self.port),
            false => write!(f, "http://{}:{}", self.host, self.port),
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/tunnel/http_proxy.rs"]
mod tests;
