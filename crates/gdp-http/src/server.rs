//! The listener: HTTP/1.1, GET and HEAD only, bounded in connections, bytes and time.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp_util::line_limit::LineLimit;
use http_body_util::Full;
use hyper::header::{ALLOW, CONNECTION, CONTENT_TYPE, HeaderName, HeaderValue, LOCATION, SET_COOKIE, WWW_AUTHENTICATE};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use socket2::{Domain, Protocol, Socket, Type};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::{sleep, timeout};

use crate::access::{Access, Admission};
use crate::error::HttpError;
use crate::exchange::{HttpRequest, HttpResponse};

/// The maximum number of connections. A further one ends the oldest of those that have not been
/// admitted yet, else the oldest. So clients that only wait, or have no token, do not keep others
/// out.
pub const MAX_CONNECTIONS: usize = 32;

/// The maximum size of a request's header in bytes, and of its fields in number.
pub const MAX_HEADER: usize = 16 << 10;
const MAX_FIELDS: usize = 64;

/// Timeout for the header of a request, which includes idle time.
pub const HEADER_TIMEOUT: Duration = Duration::from_secs(20);

/// Timeout for the handler.
const HANDLER_TIMEOUT: Duration = Duration::from_secs(10);

/// The time after which a connection ends with its current response, and how long that may take.
const LIFE: Duration = Duration::from_secs(300);
const LAST_RESPONSE: Duration = Duration::from_secs(10);

/// Headers of every response.
const HEADERS: [(&str, &str); 5] = [
    ("cache-control", "no-store"),
    ("x-content-type-options", "nosniff"),
    ("x-frame-options", "DENY"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-resource-policy", "same-origin"),
];

/// Limit on the warnings about connections that cannot be accepted.
static WARNINGS: LineLimit = LineLimit::new(1, Duration::from_secs(60));

/// A bound address with its access.
pub struct Listener {
    listener: TcpListener,
    address: SocketAddr,
    access: Access,
}

impl Listener {
    /// Binds the address. The runtime of tokio must be entered.
    ///
    /// # Errors
    ///
    /// Fails if other machines reach the address and no token is needed, and if the address cannot
    /// be bound.
    pub fn bind(addr: SocketAddr, access: Access) -> Result<Self, HttpError> {
        if !addr.ip().to_canonical().is_loopback() && !access.has_token() {
            return Err(HttpError::NotLoopback { addr });
        }
        let listener = bind(addr).map_err(|source| HttpError::Bind { addr, source })?;
        let address = listener.local_addr().map_err(|source| HttpError::Bind { addr, source })?;
        Ok(Self { listener, address, access })
    }

    /// The bound address, with the port that the system chose for port 0.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

fn bind(addr: SocketAddr) -> std::io::Result<TcpListener> {
    let socket = Socket::new(Domain::for_address(addr), Type::STREAM, Some(Protocol::TCP))?;
    // A restarted program gets its address again while old connections linger.
    socket.set_reuse_address(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&addr.into())?;
    socket.listen(128)?;
    TcpListener::from_std(socket.into())
}

/// Serves until it is dropped. `handler` gets each admitted request.
pub async fn serve<H, F>(listener: Listener, handler: H)
where
    H: Fn(HttpRequest) -> F + Send + Sync + 'static,
    F: Future<Output = HttpResponse> + Send + 'static,
{
    let Listener { listener, access, .. } = listener;
    let shared = Arc::new((access, handler));
    let mut connections = JoinSet::new();
    let mut by_age: VecDeque<Accepted> = VecDeque::new();
    loop {
        let stream = tokio::select! {
            Some(_) = connections.join_next() => continue,
            accepted = listener.accept() => accepted,
        };
        match stream {
            Ok((stream, _)) => {
                by_age.retain(|connection| !connection.task.is_finished());
                if by_age.len() >= MAX_CONNECTIONS {
                    let stranger = by_age.iter().position(|one| !one.is_admitted.load(Ordering::Relaxed));
                    by_age.remove(stranger.unwrap_or(0)).iter().for_each(|one| one.task.abort());
                }
                let is_admitted = Arc::<AtomicBool>::default();
                let served = connection(stream, HEADER_TIMEOUT, is_admitted.clone(), shared.clone());
                by_age.push_back(Accepted { task: connections.spawn(served), is_admitted });
            }
            Err(error) => {
                if let Some(suppressed) = WARNINGS.take(Instant::now()) {
                    tracing::warn!(%error, suppressed, "cannot accept an HTTP connection");
                }
                sleep(Duration::from_millis(100)).await;
            }
        }
    }
}

/// A connection that is being served.
struct Accepted {
    task: AbortHandle,
    /// Whether one of its requests was admitted.
    is_admitted: Arc<AtomicBool>,
}

async fn connection<H, F>(
    stream: TcpStream,
    header_timeout: Duration,
    is_admitted: Arc<AtomicBool>,
    shared: Arc<(Access, H)>,
) where
    H: Fn(HttpRequest) -> F + Send + Sync + 'static,
    F: Future<Output = HttpResponse> + Send + 'static,
{
    _ = stream.set_nodelay(true);
    let service = service_fn(|request| {
        let (shared, is_admitted) = (shared.clone(), is_admitted.clone());
        async move {
            let (access, handler) = &*shared;
            let admission = access.admit(&request);
            if !matches!(admission, Admission::Refused(..)) {
                is_admitted.store(true, Ordering::Relaxed);
            }
            Ok::<_, Infallible>(respond(&request, admission, handler).await)
        }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(header_timeout)
        .max_buf_size(MAX_HEADER)
        .max_headers(MAX_FIELDS)
        .serve_connection(TokioIo::new(stream), service);
    let mut served = pin!(served);
    let result = tokio::select! {
        result = served.as_mut() => result,
        () = sleep(LIFE) => {
            served.as_mut().graceful_shutdown();
            timeout(LAST_RESPONSE, served).await.unwrap_or(Ok(()))
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "an HTTP connection ended");
    }
}

async fn respond<B, H, F>(request: &Request<B>, admission: Admission, handler: &H) -> Response<Full<Bytes>>
where
    H: Fn(HttpRequest) -> F,
    F: Future<Output = HttpResponse>,
{
    let (response, more) = match admission {
        Admission::Refused(status, why) => (HttpResponse::text(status, why), refusal_header(status)),
        _ if ![Method::GET, Method::HEAD].contains(request.method()) => {
            let refused = HttpResponse::text(StatusCode::METHOD_NOT_ALLOWED, "this server only answers GET");
            (refused, vec![(ALLOW, "GET, HEAD".into())])
        }
        Admission::Redirect(cookie) => {
            // A path that begins with two slashes would lead to another host.
            let path = format!("/{}", request.uri().path().trim_start_matches(['/', '\\']));
            let cookie = cookie.map(|cookie| (SET_COOKIE, cookie));
            let more = cookie.into_iter().chain([(LOCATION, path)]).collect();
            (HttpResponse::text(StatusCode::SEE_OTHER, ""), more)
        }
        Admission::Granted => (handled(request, handler).await, Vec::new()),
    };
    let HttpResponse { status, content_type, body, policy } = response;
    let mut built = Response::new(Full::new(body));
    *built.status_mut() = status;
    let headers = built.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(content_type));
    headers.insert("content-security-policy", HeaderValue::from_static(policy));
    for (name, value) in HEADERS {
        headers.insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    for (name, value) in more {
        // Tokens and paths of requests are visible ASCII.
        if let Ok(value) = HeaderValue::try_from(value) {
            headers.insert(name, value);
        }
    }
    if status.is_client_error() && status != StatusCode::NOT_FOUND {
        headers.insert(CONNECTION, HeaderValue::from_static("close"));
    }
    built
}

fn refusal_header(status: StatusCode) -> Vec<(HeaderName, String)> {
    let is_unauthorized = status == StatusCode::UNAUTHORIZED;
    is_unauthorized.then(|| (WWW_AUTHENTICATE, "Bearer".into())).into_iter().collect()
}

async fn handled<B, H, F>(request: &Request<B>, handler: &H) -> HttpResponse
where
    H: Fn(HttpRequest) -> F,
    F: Future<Output = HttpResponse>,
{
    let accept = request.headers().get(hyper::header::ACCEPT).and_then(|value| value.to_str().ok());
    let asked = HttpRequest {
        path: request.uri().path().to_owned(),
        query: request.uri().query().unwrap_or_default().to_owned(),
        accept: accept.map(ToOwned::to_owned),
    };
    let late = |_| HttpResponse::text(StatusCode::SERVICE_UNAVAILABLE, "the answer takes too long; try again");
    timeout(HANDLER_TIMEOUT, handler(asked)).await.unwrap_or_else(late)
}

#[cfg(test)]
#[path = "../tests/unit/server.rs"]
mod tests;
