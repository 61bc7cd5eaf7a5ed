//! Local servers for remote clients. The proxy serves the name only while there is a local server.

use std::fmt::Display;
use std::pin::{Pin, pin};
use std::time::Duration;

use bytes::Bytes;
use futures::stream::FuturesUnordered;
use futures::{FutureExt, StreamExt};
use gdp::unstable::{Call, NodeError, Server};
use gdp_core::cert::{AdCert, Issued};
use gdp_ros::call::{CALL, Description, Epoch, Failure, FailureCode, Part, Reply, Request};
use gdp_ros::roster::node_name;
use gdp_ros::services::service_name;
use gdp_util::backoff::Backoff;
use gdp_wire::Name;
use tokio::sync::{Notify, watch};

use super::backend::{Backend, CallEvents};
use super::counters::Reason;
use super::running::{Cancellable, RunningCalls};
use super::{LAST_WORDS, MAX_PENDING, Route, Way};
use crate::config::What;
use crate::graph::{CallerError, Graph, Peer, Servers};
use crate::peer_proxies::Candidate;
use crate::ros2::TypeName;
use crate::route_status::{RETRY, Right, RouteError, ended_because, ticks};
use crate::turns::unless;
use crate::waiting::Waiting;

/// Backoff before a server whose type does not fit is asked again. A new one may not have announced
/// all of it yet.
const ASK_AGAIN: Backoff = Backoff::new(Duration::from_millis(500), Duration::from_secs(60));

/// A local server and its description for remote clients.
struct Offer {
    peer: Peer,
    backend: Backend,
    epoch: Epoch,
    description: Description,
    running: RunningCalls,
    /// Notified when the server is lost although the graph still lists it: a ROS 1 master does not
    /// notice.
    lost: Notify,
}

/// Reasons for which the route stops serving.
enum Turn {
    /// This proxy's turn to serve is over.
    Over,
    ServerLeft,
    Ended(NodeError),
}

/// A task that answers a request.
type Answering<'a> = Pin<Box<dyn Future<Output = ()> + Send + 'a>>;

impl Route {
    pub(super) async fn run_out(
        &self,
        way: &Way<'_>,
        right: &mut Right<Issued<AdCert>>,
        mut over: Pin<&mut (impl Future<Output = ()> + Send)>,
    ) -> Result<(), RouteError> {
        let Way { graph, node, kind, card, candidate } = *way;
        let mut servers = Servers::new(graph, &self.config.name, self.config.what);
        let (mut pause, mut ask_again, mut last) = (RETRY, ASK_AGAIN, String::new());
        loop {
            let found = async {
                let peer = match servers.until_there().now_or_never() {
                    Some(peer) => peer?,
                    None => {
                        self.route_status.set_status(Waiting::LocalServer.as_str());
                        servers.until_there().await?
                    }
                };
                Ok::<_, RouteError>((peer.clone(), self.offer(graph, kind, peer).await))
            };
            let Some(found) = unless(&mut over, found).await else { return Ok(()) };
            let (peer, offer) = found?;
            let again = async {
                match offer {
                    Ok(offer) => match node.serve(card.proof(), right.current()).await {
                        Ok(server) => return Ok(Some((offer, server))),
                        Err(error) => {
                            candidate.set_permitted(false);
                            self.route_status.pause(error, &mut pause, right).await;
                        }
                    },
                    Err(Unfit::Call(CallerError::Graph(error))) => return Err(error.into()),
                    Err(Unfit::Call(error)) if error.is_of_type() => {
                        self.refuse(candidate, &error, &mut last);
                        // A restarted server may have the same node, and other definitions.
                        let delay = ask_again.next_delay();
                        if let Ok(left) = tokio::time::timeout(delay, servers.until_left(&peer)).await {
                            left?;
                        }
                    }
                    // Another proxy of the graph may be able to serve.
                    Err(error @ (Unfit::Call(_) | Unfit::Random)) => {
                        candidate.set_permitted(false);
                        let (error, mut retry) = (error.to_string(), RETRY);
                        if error == last {
                            // A ROS 1 master lists a server that was killed for ever.
                            tokio::time::sleep(retry.next_delay()).await;
                        } else {
                            self.route_status.pause(&error, &mut retry, right).await;
                            last = error;
                        }
                    }
                    Err(error @ Unfit::OtherType { .. }) => {
                        self.refuse(candidate, &error, &mut last);
                        servers.until_left(&peer).await?;
                    }
                }
                Ok::<_, RouteError>(None)
            };
            let Some(served) = unless(&mut over, again).await else { return Ok(()) };
            let Some((offer, mut server)) = served? else { continue };
            (pause, ask_again, last) = (RETRY, ASK_AGAIN, String::new());
            candidate.set_permitted(true);
            self.is_up(&offer.description.kind.name);
            self.counters.servers(1);
            let turn = self.serve(&mut servers, &offer, &mut server, right, &mut over).await;
            self.counters.servers(0);
            drop(server);
            match turn? {
                Turn::Over => return Ok(()),
                Turn::ServerLeft => tracing::info!(service = %self.config.name, "the local server has gone"),
                Turn::Ended(error) => {
                    candidate.set_permitted(false);
                    if unless(&mut over, self.route_status.pause(error, &mut pause, right)).await.is_none() {
                        return Ok(());
                    }
                }
            }
        }
    }

    /// Records why the local server is not offered, and logs it if it is not the `last` reason.
    /// Another proxy may be able to offer it.
    fn refuse(&self, candidate: &Candidate, error: &dyn Display, last: &mut String) {
        candidate.set_permitted(false);
        let error = error.to_string();
        if error != *last {
            tracing::warn!(service = %self.config.name, "not carried: {error}");
        }
        self.route_status.set_status(&error);
        *last = error;
    }

    async fn offer(&self, graph: &Graph, kind: Option<&TypeName>, peer: Peer) -> Result<Offer, Unfit> {
        let is_action = self.config.what == What::Action;
        let (backend, mut description) = Backend::new(graph, &self.types, &self.config.name, &peer, is_action).await?;
        let got = &description.kind.name;
        let wanted = match kind {
            Some(kind) if is_action => kind.to_string(),
            Some(kind) => service_name(kind.as_str(), graph.dialect()).unwrap_or_default(),
            None => got.clone(),
        };
        if wanted != *got {
            return Err(Unfit::OtherType { got: got.clone(), wanted });
        }
        description.node = node_name(peer.node()).to_owned();
        let epoch = Epoch(u64::from_be_bytes(gdp_core::crypto::random().map_err(|_| Unfit::Random)?));
        Ok(Offer { peer, backend, epoch, description, running: RunningCalls::default(), lost: Notify::new() })
    }

    async fn serve(
        &self,
        servers: &mut Servers,
        offer: &Offer,
        server: &mut Server,
        right: &mut Right<Issued<AdCert>>,
        over: &mut (impl Future<Output = ()> + Send + Unpin),
    ) -> Result<Turn, RouteError> {
        let (mut ticks, mut ended) = (ticks(), pin!(server.ended()));
        let (gone, is_gone) = watch::channel(false);
        let mut answering = FuturesUnordered::<Answering<'_>>::new();
        let turn = loop {
            tokio::select! {
                Some(()) = answering.next() => {}
                call = server.recv() => match call {
                    Some(call) => self.take(call, offer, &is_gone, &mut answering),
                    None => break ended_because(ended.await).map(Turn::Ended),
                },
                heard = offer.backend.next_events() => match heard {
                    Ok((events, dropped)) => {
                        self.counters.events(0, dropped);
                        let answers = events.into_iter().map(|event| -> Answering<'_> { Box::pin(self.tell(event)) });
                        answering.extend(answers);
                    }
                    Err(error) => self.failed(Reason::Malformed, error),
                },
                left = servers.until_left(&offer.peer) => break left.map(|()| Turn::ServerLeft).map_err(Into::into),
                () = offer.backend.until_lost() => break Ok(Turn::ServerLeft),
                () = offer.lost.notified() => break Ok(Turn::ServerLeft),
                () = &mut *over => break Ok(Turn::Over),
                why = &mut ended => break ended_because(why).map(Turn::Ended),
                _ = ticks.tick() => {
                    self.route_status.renew(right, async |new| server.renew(new).await).await;
                    let events = offer.backend.sweep();
                    answering.extend(events.into_iter().map(|event| -> Answering<'_> { Box::pin(self.tell(event)) }));
                }
            }
        };
        // Clients of pending calls are informed that the server has left.
        gone.send_replace(true);
        let events = async { while answering.next().await.is_some() {} };
        _ = tokio::time::timeout(LAST_WORDS, events).await;
        turn
    }

    fn take<'a>(
        &'a self,
        call: Call,
        offer: &'a Offer,
        is_gone: &watch::Receiver<bool>,
        answering: &mut FuturesUnordered<Answering<'a>>,
    ) {
        let request = if call.encoding() == CALL { Request::from_bytes(call.body()).ok() } else { None };
        let failure = |code, text: &str| Reply::Failure(Failure::new(code, text));
        let reply = match request {
            // A description is large, so it is not queued: the client asks again.
            Some(Request::Describe) if answering.len() >= MAX_PENDING => {
                return self.failed(Reason::Busy, "too many wait");
            }
            None => {
                self.failed(Reason::Malformed, "a request that no proxy of this release sends");
                failure(FailureCode::Malformed, "not a request of this release")
            }
            Some(Request::Cancel(id)) => return offer.running.cancel(call.client(), id),
            Some(Request::Describe) => Reply::Description(offer.epoch, offer.description.clone()),
            Some(Request::Call { epoch, .. } | Request::Events { epoch, .. }) if epoch != offer.epoch => {
                failure(FailureCode::Changed, "")
            }
            Some(Request::Events { after, .. }) => match offer.backend.ask(call, after) {
                Ok(None) => return,
                Ok(Some(events)) => return answering.push(Box::pin(self.tell(events))),
                Err(refused) => {
                    let (call, failure) = *refused;
                    return answering.push(Box::pin(self.reply(call, Reply::Failure(failure))));
                }
            },
            Some(Request::Call { .. }) if answering.len() >= MAX_PENDING => {
                self.failed(Reason::Busy, "too many wait");
                failure(FailureCode::Busy, "")
            }
            Some(Request::Call { part, body, .. }) => {
                let mut is_gone = is_gone.clone();
                // Parts of actions change the state of goals, so they run to the end.
                let mut cancellable = (part == Part::Service).then(|| offer.running.begin(call.client(), call.id()));
                let answer = async move {
                    let _pending = self.counters.begun();
                    let answer = tokio::select! {
                        () = cancelled(&mut cancellable) => return self.counters.copies_cancelled(1),
                        answer = self.ask(offer, part, call.client(), body) => answer,
                        _ = is_gone.wait_for(|gone| *gone) => Err(Failure::new(FailureCode::ServerLeft, "")),
                    };
                    let reply = match answer {
                        Ok(answer) => {
                            self.counters.answered();
                            Reply::Answer(answer)
                        }
                        Err(failure) => {
                            self.failed(failure.code.into(), &failure);
                            Reply::Failure(failure)
                        }
                    };
                    self.reply(call, reply).await;
                };
                return answering.push(Box::pin(answer));
            }
        };
        answering.push(Box::pin(self.reply(call, reply)));
    }

    /// Calls the local server. A failed call alone does not mean that the server has left.
    async fn ask(&self, offer: &Offer, part: Part, caller: Name, body: Bytes) -> Result<Bytes, Failure> {
        match offer.backend.call(part, caller, body).await {
            Err(failure) if failure.code == FailureCode::ServerLeft && matches!(offer.peer, Peer::Ros1(_)) => {
                if !offer.backend.has_lost_server().await {
                    return Err(Failure::new(FailureCode::Refused, failure.text()));
                }
                offer.lost.notify_one();
                Err(failure)
            }
            answered => answered,
        }
    }

    async fn tell(&self, (call, events): CallEvents) {
        self.counters.events(events.events.len() as u64, 0);
        self.reply(call, Reply::Events(events)).await;
    }

    async fn reply(&self, call: Call, reply: Reply) {
        match reply.to_bytes() {
            Ok(bytes) => {
                if let Err(error) = call.reply(CALL, &bytes).await {
                    self.failed(Reason::SendFailed, error);
                }
            }
            Err(error) => self.failed(Reason::Malformed, error),
        }
    }
}

impl From<FailureCode> for Reason {
    fn from(code: FailureCode) -> Self {
        match code {
            FailureCode::ServerLeft => Self::Left,
            FailureCode::Refused => Self::Refused,
            FailureCode::Busy => Self::Busy,
            FailureCode::Malformed => Self::Malformed,
            FailureCode::Changed => Self::Changed,
        }
    }
}

async fn cancelled(call: &mut Option<Cancellable<'_>>) {
    match call {
        Some(call) => call.cancelled().await,
        None => std::future::pending().await,
    }
}

/// Reasons for which a local server is not offered.
#[derive(Debug, thiserror::Error)]
enum Unfit {
    #[error(transparent)]
    Call(#[from] CallerError),
    #[error("the local server is of {got}, and the name is of {wanted}")]
    OtherType { got: String, wanted: String },
    #[error("the system gives no random numbers")]
    Random,
}
