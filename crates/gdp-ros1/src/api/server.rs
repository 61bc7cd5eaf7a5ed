//! The server of the slave API: HTTP/1.1, bounded in connections, bytes and time. The caller
//! interprets the requests.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode, header};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::slave::{Refusal, SlaveCall, failure};
use crate::connections::accept;
use crate::xmlrpc::{Fault, Value, decode_call, encode_response};

/// Maximum number of connections. Masters and tools close theirs after a call; roscpp keeps one
/// open.
const MAX_CONNECTIONS: usize = 128;

/// Maximum size of a call, in bytes. A `publisherUpdate` of ten thousand publishers is smaller.
const MAX_CALL: usize = 1 << 20;

/// Timeout for the header of a request, which includes idle time, and for its body.
const TIMEOUT: Duration = Duration::from_secs(20);

/// Accepts connections until it is dropped. `answer` must not block.
pub async fn serve(listener: TcpListener, answer: impl Fn(SlaveCall) -> Value + Send + Sync + 'static) {
    let answer = Arc::new(answer);
    let mut connections = JoinSet::new();
    loop {
        let stream = accept(&listener, &mut connections, MAX_CONNECTIONS).await;
        connections.spawn(connection(stream, answer.clone()));
    }
}

async fn connection(stream: TcpStream, answer: Arc<impl Fn(SlaveCall) -> Value>) {
    _ = stream.set_nodelay(true);
    let service = service_fn(|request| respond(request, &*answer));
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(TIMEOUT)
        .max_buf_size(64 << 10)
        .title_case_headers(true)
        .serve_connection(TokioIo::new(stream), service);
    if let Err(error) = served.await {
        tracing::debug!(%error, "a connection to the slave API ended");
    }
}

async fn respond(
    request: Request<Incoming>,
    answer: &impl Fn(SlaveCall) -> Value,
) -> Result<Response<Full<Bytes>>, Infallible> {
    if request.method() != Method::POST {
        return Ok(status(StatusCode::METHOD_NOT_ALLOWED));
    }
    let Ok(body) = timeout(TIMEOUT, Limited::new(request.into_body(), MAX_CALL).collect()).await else {
        return Ok(status(StatusCode::REQUEST_TIMEOUT));
    };
    let Ok(body) = body else { return Ok(status(StatusCode::PAYLOAD_TOO_LARGE)) };
    let result = match decode_call(&body.to_bytes()) {
        Ok(call) => match SlaveCall::try_from(call) {
            Ok(call) => Ok(answer(call)),
            Err(Refusal::Params(text)) => Ok(failure(-1, &text)),
            Err(Refusal::Unknown(fault)) => Err(fault),
        },
        Err(error) => Err(Fault { code: 1, text: error.to_string() }),
    };
    let mut response = Response::new(Full::new(Bytes::from(encode_response(&result))));
    response.headers_mut().insert(header::CONTENT_TYPE, header::HeaderValue::from_static("text/xml"));
    Ok(response)
}

/// Returns a response without a body.
fn status(status: StatusCode) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::default());
    *response.status_mut() = status;
    response
}
