//! Calls the services of other nodes, without their types at compile time.

use std::time::Duration;

use bytes::Bytes;
use hyper::Uri;
use tokio::io::AsyncReadExt;
use tokio::time::timeout;

use crate::api::client::host_and_port;
use crate::api::master::{Master, MasterError};
use crate::tcpros::{Header, Stream, TcprosError};

/// A client of one service. Each call looks up the server and opens a new connection, so it always
/// reaches the current server.
#[derive(Clone, Debug)]
pub struct ServiceClient {
    pub(crate) master: Master,
    pub(crate) service: String,
    pub(crate) max_message: usize,
}

/// The type of a service, as its server announces it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceInfo {
    /// The type, such as `std_srvs/SetBool`.
    pub kind: String,
    pub md5sum: String,
    /// The name of the serving node, or empty if the header lacks it.
    pub caller_id: String,
}

/// The reason why a call has no response.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    #[error("nobody serves {service}: is its node running?")]
    NoServer { service: String },
    #[error(transparent)]
    Master(#[from] MasterError),
    #[error("{service} is said to be served at {uri:?}, which is not of the form rosrpc://HOST:PORT")]
    Uri { service: String, uri: String },
    #[error("{service} at {uri}: {source}")]
    Connection { service: String, uri: String, source: TcprosError },
    /// The server received the request and returned this error.
    #[error("{service} failed: {text}")]
    Failed { service: String, text: String },
    /// The server may have received the request.
    #[error("no response of {service} within {limit:?}")]
    Timeout { service: String, limit: Duration },
}

impl ServiceClient {
    /// Requests the type and MD5 sum from the server, without a call.
    pub async fn probe(&self, limit: Duration) -> Result<ServiceInfo, CallError> {
        self.within(limit, async {
            let (_, _, header) = self.connect(&[("probe", "1")]).await?;
            let field = |name| header.get(name).unwrap_or_default().to_owned();
            Ok(ServiceInfo { kind: field("type"), md5sum: field("md5sum"), caller_id: field("callerid") })
        })
        .await
    }

    /// Calls the service. Request and response are in ROS 1 serialization without length prefixes.
    /// The server refuses an `md5sum` other than its own, except `*`.
    pub async fn call(&self, md5sum: &str, request: Bytes, limit: Duration) -> Result<Bytes, CallError> {
        self.within(limit, async {
            let (mut stream, uri, _) = self.connect(&[("md5sum", md5sum)]).await?;
            let exchanged = async {
                stream.write_message(&request).await?;
                let ok = stream.reader.read_u8().await?;
                Ok((ok, stream.read_message(self.max_message).await?))
            };
            let failed = |source| CallError::Connection { service: self.service.clone(), uri, source };
            match exchanged.await.map_err(failed)? {
                (0, text) => {
                    let text = String::from_utf8_lossy(&text).into_owned();
                    Err(CallError::Failed { service: self.service.clone(), text })
                }
                (_, response) => Ok(response),
            }
        })
        .await
    }

    async fn within<T>(
        &self,
        limit: Duration,
        call: impl Future<Output = Result<T, CallError>>,
    ) -> Result<T, CallError> {
        let late = |_| CallError::Timeout { service: self.service.clone(), limit };
        timeout(limit, call).await.map_err(late)?
    }

    /// Connects to the server. Also returns its URI and connection header.
    async fn connect(&self, fields: &[(&str, &str)]) -> Result<(Stream, String, Header), CallError> {
        let service = || self.service.clone();
        let uri = self.master.lookup_service(&self.service).await.map_err(|error| match error {
            MasterError::Refused { .. } => CallError::NoServer { service: service() },
            error => error.into(),
        })?;
        let Some((host, port)) =
            uri.parse().ok().and_then(|parsed: Uri| host_and_port(&parsed).map(|(host, port)| (host.to_owned(), port)))
        else {
            return Err(CallError::Uri { service: service(), uri });
        };
        let ours = [("callerid", self.master.caller_id.as_str()), ("md5sum", "*"), ("service", &self.service)];
        let connected = async {
            let mut stream = Stream::connect(&host, port).await?;
            let theirs = stream.greet(&Header::new(ours.into_iter().chain(fields.iter().copied()))).await?;
            Ok((stream, theirs))
        };
        match connected.await {
            Ok((stream, theirs)) => Ok((stream, uri, theirs)),
            Err(source) => Err(CallError::Connection { service: service(), uri, source }),
        }
    }
}
