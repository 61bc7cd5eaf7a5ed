//! Requests to remote servers: descriptions, calls, and events of goals.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::StreamExt;
use futures::future::join_all;
use futures::stream::FuturesUnordered;
use gdp::MessageId;
use gdp::unstable::{Client, NodeError};
use gdp_ros::action::cdr;
use gdp_ros::call::{CALL, Description, Epoch, Events, Failure, FailureCode, Part, Reply, Request};
use gdp_ros::services::Converters;
use gdp_wire::Name;
use parking_lot::Mutex;

use super::copies::Copies;
use super::counters::Reason;
use crate::offload::run_blocking_if_large;

/// Timeout of a request for events. The server's proxy answers at least once a minute, with or
/// without events.
const TIMEOUT: Duration = Duration::from_secs(90);

/// Number of attempts to have a server described.
const ATTEMPTS: usize = 20;
/// Timeout of each attempt.
const ATTEMPT: Duration = Duration::from_secs(2);
/// Pause after an attempt that failed at once.
const SOON: Duration = Duration::from_millis(200);

/// A remote server, as its description announced it.
pub struct Known {
    pub instance: Name,
    pub epoch: Epoch,
    pub there: Description,
    pub converters: Mutex<Converters>,
}

/// The answer to a description request.
pub type Described = Result<(Epoch, Description), String>;

/// A server that announced itself that it differs from the known one.
pub struct Changed {
    pub known: Arc<Known>,
    /// Its new description, or `None` if that was not awaited.
    pub now: Option<Described>,
}

/// A call that failed, with the reason.
pub struct Failed {
    pub failure: Failure,
    pub reason: Reason,
}

impl From<Failure> for Failed {
    fn from(failure: Failure) -> Self {
        Self { reason: failure.code.into(), failure }
    }
}

pub fn no_server() -> Failed {
    Failure::new(FailureCode::ServerLeft, "it is not attached any more").into()
}

async fn ask(client: &Client, instance: Name, request: &Request) -> Result<Reply, NodeError> {
    ask_with(client, instance, request, |_| {}).await
}

/// Sends a request. Passes its ID to `begun` when it is sent.
async fn ask_with(
    client: &Client,
    instance: Name,
    request: &Request,
    begun: impl FnOnce(MessageId) + Send,
) -> Result<Reply, NodeError> {
    let message = client.call_at_with(instance, CALL, &request.to_bytes(), begun).await?;
    let reply = if message.encoding == CALL { Reply::from_bytes(&message.body).ok() } else { None };
    reply.ok_or(NodeError::Protocol("a reply that no proxy of this release sends"))
}

/// Requests the server's description, with repeated attempts, which are harmless. The path to a
/// server that has just attached may not exist yet, so a first request may be lost. A call is not:
/// it follows the description.
pub async fn describe(client: &Client, instance: Name) -> Described {
    let mut last = "it does not say what it serves".to_owned();
    for _ in 0..ATTEMPTS {
        match tokio::time::timeout(ATTEMPT, ask(client, instance, &Request::Describe)).await {
            Err(_) => {}
            Ok(Ok(Reply::Description(epoch, description))) => return Ok((epoch, description)),
            Ok(Ok(Reply::Failure(failure))) => return Err(failure.to_string()),
            Ok(Ok(Reply::Answer(_) | Reply::Events(_))) => return Err("it answered another question".into()),
            Ok(Err(error)) => {
                last = error.to_string();
                tokio::time::sleep(SOON).await;
            }
        }
    }
    Err(last)
}

/// The answer to a request for events.
pub enum News {
    Events(Events),
    /// No events, with the reason.
    None(String),
    Changed(Changed),
}

/// Requests the events of this proxy's goals after event `after`. It waits for a moment first if
/// the last request failed.
pub async fn events(client: &Client, known: &Arc<Known>, after: u64, has_failed: bool) -> News {
    if has_failed {
        tokio::time::sleep(SOON).await;
    }
    let request = Request::Events { epoch: known.epoch, after };
    match tokio::time::timeout(TIMEOUT, ask(client, known.instance, &request)).await {
        Err(_) => News::None("no answer".into()),
        Ok(Ok(Reply::Events(events))) => News::Events(events),
        Ok(Ok(Reply::Failure(failure))) if failure.code == FailureCode::Changed => {
            // A server that reports a change repeatedly does not cause constant requests.
            tokio::time::sleep(SOON).await;
            News::Changed(Changed { known: known.clone(), now: Some(describe(client, known.instance).await) })
        }
        Ok(Ok(Reply::Failure(failure))) => News::None(failure.to_string()),
        Ok(Ok(Reply::Answer(_) | Reply::Description(..))) => News::None("it answered another question".into()),
        Ok(Err(error)) => News::None(error.to_string()),
    }
}

/// One request of a local client to one or several servers.
pub struct Asking<'a> {
    client: &'a Client,
    request: Bytes,
    part: Part,
    changed: Mutex<Vec<Changed>>,
    /// Servers that have changed, and whose new description is awaited.
    stale: Mutex<Vec<Arc<Known>>>,
    pub copies: Copies,
}

impl<'a> Asking<'a> {
    pub fn new(client: &'a Client, part: Part, request: Bytes) -> Self {
        let (changed, stale, copies) = Default::default();
        Self { client, request, part, changed, stale, copies }
    }

    /// Sends the request and waits for the answer without a timeout.
    pub async fn answer(&self, servers: &[Arc<Known>]) -> Result<Bytes, Failed> {
        match (self.part, servers) {
            (_, []) => Err(no_server()),
            (Part::Service, [_, _, ..]) => self.first_answer(servers).await,
            (Part::CancelGoal, [_, _, ..]) => self.cancel(servers).await,
            (Part::GetResult, [_, _, ..]) => self.first_result(servers).await,
            (_, [nearest, ..]) => self.call(nearest).await,
        }
    }

    /// Returns the servers that were found to have changed meanwhile.
    pub fn changed(self) -> Vec<Changed> {
        let stale = self.stale.into_inner().into_iter().map(|known| Changed { known, now: None });
        self.changed.into_inner().into_iter().chain(stale).collect()
    }

    /// Calls one server. A server that has changed since its description has not executed the
    /// request, so it is called once more.
    async fn call(&self, known: &Arc<Known>) -> Result<Bytes, Failed> {
        let convert = || known.converters.lock().request.convert(self.request.clone());
        let body = run_blocking_if_large(self.request.len(), convert).map_err(unconvertible)?;
        let failed = match self.exchange(known, known.epoch, body.clone()).await {
            Err(failed) if failed.reason == Reason::Changed => failed,
            answered => return answered,
        };
        self.stale.lock().push(known.clone());
        let now = describe(self.client, known.instance).await;
        self.stale.lock().retain(|stale| !Arc::ptr_eq(stale, known));
        // An equal description means equal conversion.
        let again = now.as_ref().ok().filter(|(epoch, there)| *epoch != known.epoch && *there == known.there);
        let again = again.map(|(epoch, _)| *epoch);
        self.changed.lock().push(Changed { known: known.clone(), now: Some(now) });
        match again {
            Some(epoch) => self.exchange(known, epoch, body).await,
            None => Err(failed),
        }
    }

    async fn exchange(&self, known: &Known, epoch: Epoch, body: Bytes) -> Result<Bytes, Failed> {
        let failed = |reason, code, why: &dyn ToString| Failed { failure: Failure::new(code, why.to_string()), reason };
        let request = Request::Call { epoch, part: self.part, body };
        let replied = ask_with(self.client, known.instance, &request, |id| self.copies.begin(known.instance, id)).await;
        self.copies.end(known.instance);
        match replied {
            Ok(Reply::Answer(body)) => {
                run_blocking_if_large(body.len(), || known.converters.lock().response.convert(body))
                    .map_err(unconvertible)
            }
            Ok(Reply::Failure(failure)) => Err(failure.into()),
            Ok(Reply::Description(..) | Reply::Events(_)) => {
                Err(failed(Reason::Malformed, FailureCode::Malformed, &"it answered another question"))
            }
            Err(error) => {
                let reason = match error {
                    NodeError::InstanceLeft { .. } | NodeError::NoInstance { .. } => Reason::Left,
                    NodeError::TooManyCalls(_) => Reason::Busy,
                    NodeError::Protocol(_) => Reason::Malformed,
                    _ => Reason::SendFailed,
                };
                Err(failed(reason, FailureCode::ServerLeft, &error))
            }
        }
    }

    /// Sends the request to all these servers, nearest first, and returns the first answer. A
    /// failure is returned only if all fail.
    async fn first_answer(&self, servers: &[Arc<Known>]) -> Result<Bytes, Failed> {
        self.copies.record();
        let copy = |(rank, known)| async move { (rank, self.call(known).await) };
        let mut copies: FuturesUnordered<_> = servers.iter().enumerate().map(copy).collect();
        let mut failure = None;
        while let Some((rank, answer)) = copies.next().await {
            match answer {
                Ok(answer) => {
                    self.copies.win(rank);
                    return Ok(answer);
                }
                Err(failed) => failure = Some(more_useful(failure, failed)),
            }
        }
        Err(failure.unwrap_or_else(no_server))
    }

    /// Sends a cancellation to all servers and merges their answers.
    async fn cancel(&self, servers: &[Arc<Known>]) -> Result<Bytes, Failed> {
        let (mut answers, mut failed) = (Vec::new(), None);
        for answer in join_all(servers.iter().map(|known| self.call(known))).await {
            match answer.map(|answer| cdr::Canceling::read(&answer)) {
                Ok(Ok(answer)) => answers.push(answer),
                Ok(Err(error)) => failed = Some(Failure::new(FailureCode::Malformed, error).into()),
                Err(error) => failed = Some(error),
            }
        }
        let merged = cdr::Canceling::merge(answers).map(|merged| merged.write());
        merged.ok_or_else(|| failed.unwrap_or_else(no_server))
    }

    /// Requests the result of a goal from all servers, because any of them may have the goal.
    async fn first_result(&self, servers: &[Arc<Known>]) -> Result<Bytes, Failed> {
        let mut asked: FuturesUnordered<_> = servers.iter().map(|known| self.call(known)).collect();
        let mut last = Err(no_server());
        while let Some(answer) = asked.next().await {
            match answer {
                Ok(answer) if cdr::result_status(&answer) != Ok(cdr::UNKNOWN) => return Ok(answer),
                answer => last = if last.is_ok() { last } else { answer },
            }
        }
        last
    }
}

fn unconvertible(error: impl ToString) -> Failed {
    Failed { failure: Failure::new(FailureCode::Malformed, error), reason: Reason::Unconvertible }
}

/// Returns the failure that tells the client more. The server's own error comes first. The absence
/// of a server comes last. Of equal ones, the earlier counts.
fn more_useful(one: Option<Failed>, other: Failed) -> Failed {
    let rank = |failed: &Failed| match failed.reason {
        Reason::Refused => 0,
        Reason::Unconvertible => 1,
        Reason::Malformed => 2,
        Reason::Busy => 3,
        Reason::Changed => 4,
        Reason::SendFailed => 5,
        Reason::Left | Reason::Unanswered => 6,
    };
    match one {
        Some(one) if rank(&one) <= rank(&other) => one,
        _ => other,
    }
}

#[cfg(test)]
#[path = "../../tests/unit/call/asking.rs"]
mod tests;
