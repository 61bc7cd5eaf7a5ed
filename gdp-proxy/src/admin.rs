//! The admin socket and the metrics of a proxy. Both show its statistics, which the main loop hands
//! out on request.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use gdp_http::HttpResponse;
use gdp_http::metrics::PATH;
use gdp_proto::admin::error::{ErrorCode, ErrorReply};
use gdp_proto::admin::proxy::ProxyReply;
use gdp_proto::admin::{MAX_REQUEST, Reply, Request, parse_request, refusal_line, reply_line};
use gdp_proto::control::RefusalCode;
use gdp_util::folders;
use gdp_util::line_socket::{self, Answer, Answering, Listening, SocketError, Unanswered};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio::time::timeout;

use crate::config::Config;
use crate::metrics::exposition;
use crate::stats::Stats;

/// The maximum number of requests that wait for the main loop.
const MAX_WAITING: usize = 16;

/// Time for the main loop to hand out the statistics. It is busy while it reads a new
/// configuration.
const TIMEOUT: Duration = Duration::from_secs(5);

/// The other end of [`StatsHandle`], in the main loop.
pub struct StatsRequests(mpsc::Receiver<oneshot::Sender<Stats>>);

impl StatsRequests {
    /// Waits for the next request. Safe to cancel.
    pub async fn next(&mut self) -> oneshot::Sender<Stats> {
        match self.0.recv().await {
            Some(request) => request,
            None => std::future::pending().await,
        }
    }
}

/// Asks the main loop for the statistics.
#[derive(Clone)]
struct StatsHandle(mpsc::Sender<oneshot::Sender<Stats>>);

impl StatsHandle {
    async fn get(&self) -> Result<ProxyReply, String> {
        let (answer, answered) = oneshot::channel();
        let asked = async {
            self.0.send(answer).await.ok()?;
            answered.await.ok()
        };
        let stats = timeout(TIMEOUT, asked).await.ok().flatten();
        let stats = stats.ok_or("the proxy is busy or ends; try again")?;
        serde_json::to_value(stats).and_then(serde_json::from_value).map_err(|error| error.to_string())
    }
}

/// The socket and the metrics, until this is dropped.
pub struct Serving {
    _socket: Option<Listening>,
    _tasks: JoinSet<()>,
}

/// Opens what the configuration names. Without a name for the socket, the default one is used if it
/// is free.
///
/// # Errors
///
/// Fails if a named socket or the address of metrics cannot be opened.
pub fn serve(config: &Config) -> Result<(Serving, StatsRequests)> {
    let (ask, requests) = mpsc::channel(MAX_WAITING);
    let (handle, mut tasks) = (StatsHandle(ask), JoinSet::new());
    let socket = match open(config.socket.clone()) {
        Ok((listening, listener)) => {
            tasks.spawn(line_socket::serve(listener, handle.clone()));
            Some(listening)
        }
        Err(error) if config.socket.is_some() => return Err(error.into()),
        Err(error) => {
            tracing::info!("there is no admin socket: {error}");
            None
        }
    };
    if let Some(address) = config.metrics {
        let listener = gdp_http::metrics::listen(address, config.metrics_token.as_deref()).context("metrics")?;
        tracing::info!("metrics on http://{}{PATH}", listener.address());
        tasks.spawn(gdp_http::serve(listener, move |request| {
            let handle = handle.clone();
            async move {
                if request.path != PATH {
                    return HttpResponse::not_found();
                }
                match handle.get().await {
                    Ok(stats) => exposition(&stats).response(&request),
                    Err(error) => HttpResponse::unavailable(&error),
                }
            }
        }));
    }
    Ok((Serving { _socket: socket, _tasks: tasks }, StatsRequests(requests)))
}

fn open(path: Option<PathBuf>) -> Result<(Listening, tokio::net::UnixListener), SocketError> {
    let path = match path {
        Some(path) => path,
        None => folders::proxy_socket()
            .map_err(|error| SocketError::Io { path: "proxy.sock".into(), source: std::io::Error::other(error) })?,
    };
    line_socket::listen(&path)
}

impl Answering for StatsHandle {
    const MAX_LINE: usize = MAX_REQUEST;

    async fn answer(&self, line: Vec<u8>) -> Answer {
        let reply = match parse_request(&line) {
            Ok(Request::Status) => match self.get().await {
                Ok(stats) => Reply::Proxy(Box::new(stats)),
                Err(error) => Reply::Error(ErrorReply::new(ErrorCode::Failed, &error)),
            },
            Ok(_) => {
                let reason = "this is the socket of a proxy, which answers `gdp-ctl status` and `top` alone; ask the \
                              daemon of a switch";
                Reply::Error(ErrorReply::new(ErrorCode::Refused(RefusalCode::Unsupported), reason))
            }
            Err(reason) => Reply::Error(ErrorReply::new(ErrorCode::Refused(RefusalCode::Malformed), &reason)),
        };
        Answer::Line(reply_line(&reply))
    }

    fn refuse(&self, why: Unanswered) -> String {
        let code = if let Unanswered::TooLong(_) = why { RefusalCode::Malformed } else { RefusalCode::Limit };
        refusal_line(code, &why.to_string())
    }
}

#[cfg(test)]
#[path = "../tests/unit/admin.rs"]
mod tests;
