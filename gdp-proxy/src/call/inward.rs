//! Servers elsewhere, for clients here. A server stands for them in the graph only while at least one of them is attached.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::pin::{Pin, pin};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures::StreamExt;
use futures::future::join_all;
use futures::stream::FuturesUnordered;
use gdp::cert::Reading;
use gdp::node::{Client, NodeError};
use gdp::{Name, NameCard, Node};
use gdp_ros::action::{Board, GoalId, Goals, cdr};
use gdp_ros::call::{CALL, Description, Epoch, Event, Events, Failure, FailureCode, Part, Reply, Request};
use gdp_ros::services::{Converters, service_name};

use super::counters::Reason;
use super::stand::Stands;
use super::{MAX_PENDING, Route, lock};
use crate::config::What;
use crate::graph::{Asked, Graph, GraphError};
use crate::ros2::TypeName;
use crate::standing::{Pause, Right, RouteError, ended_because, ticks};

/// Servers elsewhere that are told apart; of more, the nearest.
const MAX_SERVERS: usize = 64;

/// For a server's proxy to answer a question about events, which it does once a minute though there are none.
const PATIENCE: Duration = Duration::from_secs(90);

/// To have a server described: how often it is asked, how long each answer is waited for, and how soon it is asked again if that cannot be.
const ATTEMPTS: usize = 20;
const ATTEMPT: Duration = Duration::from_secs(2);
const SOON: Duration = Duration::from_millis(200);

/// For clients here to be told that nothing is called any more.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Before a server is asked again that was of no use.
const ASK_AGAIN: Duration = Duration::from_secs(5);

/// A server elsewhere.
enum Remote {
    Asked,
    Known(Arc<Known>),
    /// It cannot be called, at least until then.
    Unfit(Instant),
}

struct Known {
    instance: Name,
    epoch: Epoch,
    converters: Mutex<Converters>,
}

/// What has come of something that was begun.
enum Done {
    /// A call, which is over.
    Call,
    Description(Name, Result<(Epoch, Description), String>),
    /// With the event that was had before.
    Events(Arc<Known>, u64, Result<Events, String>),
    /// A server is another than the one that was described.
    Changed(Name),
}

type Doing<'a> = Pin<Box<dyn Future<Output = Done> + Send + 'a>>;

/// What this side knows of all servers of the name.
struct In<'a> {
    graph: &'a Graph,
    /// Of the configuration or the card.
    kind: Option<&'a TypeName>,
    client: &'a Client,
    remotes: BTreeMap<Name, Remote>,
    /// What stands for them, and what it is.
    local: Option<(Arc<Stands>, Description)>,
    goals: &'a Mutex<Goals<Name>>,
    board: Board,
}

impl Route {
    pub(super) async fn run_in(
        &self,
        graph: &Graph,
        node: &Node,
        kind: Option<&TypeName>,
        card: &NameCard,
        mut right: Right<Reading>,
    ) -> Result<Infallible, RouteError> {
        let mut pause = Pause::new();
        loop {
            let error = match node.client(card.proof(), right.held()).await {
                Ok(client) => {
                    pause = Pause::new();
                    self.carry_in(graph, &client, kind, &mut right).await?
                }
                Err(error) => error,
            };
            self.counters.servers(0);
            self.standing.pause(error, &mut pause, &mut right).await;
        }
    }

    /// Returns when the right to call has ended, with the reason.
    async fn carry_in(
        &self,
        graph: &Graph,
        client: &Client,
        kind: Option<&TypeName>,
        right: &mut Right<Reading>,
    ) -> Result<NodeError, RouteError> {
        let goals = Mutex::new(Goals::default());
        let (remotes, local, board) = (BTreeMap::new(), None, Board::default());
        let mut to = In { graph, kind, client, remotes, local, goals: &goals, board };
        let (mut ticks, mut changes, mut ended) = (ticks(), client.changes(), pin!(client.ended()));
        changes.mark_changed();
        let mut doing = FuturesUnordered::<Doing<'_>>::new();
        self.standing.set_status("waiting for a server elsewhere");
        loop {
            let local = to.local.as_ref().map(|(local, _)| local.clone());
            tokio::select! {
                Some(done) = doing.next() => self.done(&mut to, done, &mut doing).await?,
                asked = next(local.as_deref()) => match (asked, local) {
                    (Ok((part, asked)), Some(local)) => self.begin(&to, local, part, asked, &mut doing).await,
                    (Err(error), _) => self.failed(Reason::Malformed, error),
                    (Ok(_), None) => {}
                },
                Ok(()) = changes.changed() => self.look(&mut to, &mut doing).await,
                why = &mut ended => {
                    // Calls end with the client: who waits for them is told.
                    let told = async { while doing.next().await.is_some() {} };
                    _ = tokio::time::timeout(LAST_WORDS, told).await;
                    return ended_because(why);
                }
                _ = ticks.tick() => {
                    self.standing.renew(right, async |new| client.renew(new).await).await;
                    let now = Instant::now();
                    lock(to.goals).sweep(now);
                    if to.board.sweep(now) {
                        self.show(&to).await;
                    }
                    self.look(&mut to, &mut doing).await;
                }
            }
        }
    }

    /// Compares the servers that are attached with those that are known.
    async fn look<'a>(&'a self, to: &mut In<'a>, doing: &mut FuturesUnordered<Doing<'a>>) {
        let now = Instant::now();
        let attached: Vec<Name> = to.client.instances().iter().take(MAX_SERVERS).map(|one| one.name).collect();
        let gone: Vec<Name> = to.remotes.keys().filter(|name| !attached.contains(name)).copied().collect();
        for name in gone {
            to.remotes.remove(&name);
            // Those who ask for results are told as their calls fail.
            lock(to.goals).end_all(now, name);
            if to.board.leave(now, &name) {
                self.show(to).await;
            }
        }
        for name in attached {
            let ask = match to.remotes.get(&name) {
                None => true,
                Some(Remote::Unfit(until)) => *until <= now,
                Some(Remote::Asked | Remote::Known(_)) => false,
            };
            if ask {
                to.remotes.insert(name, Remote::Asked);
                let client = to.client;
                doing.push(Box::pin(async move { Done::Description(name, describe(client, name).await) }));
            }
        }
        self.withdraw_if_alone(to);
    }

    fn withdraw_if_alone(&self, to: &mut In<'_>) {
        let known = to.remotes.values().filter(|remote| matches!(remote, Remote::Known(_))).count();
        self.counters.servers(known);
        if known == 0 && to.local.take().is_some() {
            tracing::info!(service = %self.config.name, "no server elsewhere is left, so it is not announced here any more");
            self.standing.set_status("waiting for a server elsewhere");
        }
    }

    async fn done<'a>(
        &'a self,
        to: &mut In<'a>,
        done: Done,
        doing: &mut FuturesUnordered<Doing<'a>>,
    ) -> Result<(), RouteError> {
        match done {
            Done::Call => {}
            Done::Changed(name) => {
                // It is asked anew at the next look, which is not at once: whoever says so again and again is not asked all the time.
                if let Some(remote) = to.remotes.get_mut(&name) {
                    *remote = Remote::Unfit(Instant::now());
                }
                self.withdraw_if_alone(to);
            }
            Done::Description(name, described) => {
                if !matches!(to.remotes.get(&name), Some(Remote::Asked)) {
                    return Ok(());
                }
                let fit = match described {
                    Ok((epoch, there)) => self.fit(to, name, epoch, &there)?,
                    Err(error) => Err(error),
                };
                match fit {
                    Ok(known) => {
                        to.remotes.insert(name, Remote::Known(known.clone()));
                        self.withdraw_if_alone(to);
                        if self.config.what == What::Action {
                            doing.push(ask_for_events(to.client, known, 0, Duration::ZERO));
                        }
                    }
                    Err(error) => {
                        tracing::warn!(service = %self.config.name, server = %name, "not called: {error}");
                        if to.local.is_none() {
                            self.standing.set_status(&error);
                        }
                        to.remotes.insert(name, Remote::Unfit(Instant::now() + ASK_AGAIN));
                    }
                }
            }
            Done::Events(known, after, told) => {
                let is_known =
                    matches!(to.remotes.get(&known.instance), Some(Remote::Known(now)) if Arc::ptr_eq(now, &known));
                if !is_known {
                    return Ok(());
                }
                let (after, pause) = match told {
                    Ok(events) => {
                        let last = events.last;
                        self.publish(to, known.instance, events).await;
                        (last, Duration::ZERO)
                    }
                    Err(error) => {
                        tracing::debug!(service = %self.config.name, server = %known.instance, "no events: {error}");
                        (after, SOON)
                    }
                };
                doing.push(ask_for_events(to.client, known, after, pause));
            }
        }
        Ok(())
    }

    /// Whether a server can be called as what stands for it here, which is made if it is the first. The outer error is the graph's.
    fn fit(
        &self,
        to: &mut In<'_>,
        instance: Name,
        epoch: Epoch,
        there: &Description,
    ) -> Result<Result<Arc<Known>, String>, RouteError> {
        let dialect = to.graph.dialect();
        let here = match (self.config.what, there.kind.dialect == dialect) {
            (What::Service, _) => self.types.service_counterpart(there, dialect),
            (What::Action, true) => Ok(there.clone()),
            (What::Action, false) => return Ok(Err("it is an action of ROS 1, which are topics".into())),
        };
        let here = match here {
            Ok(here) => here,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let wanted = to.kind.map(|kind| match self.config.what {
            What::Service => service_name(kind.as_str(), dialect).unwrap_or_default(),
            What::Action => kind.to_string(),
        });
        if let Some(wanted) = wanted.filter(|wanted| *wanted != here.kind.name) {
            return Ok(Err(format!("it is of {}, and the name is of {wanted}", here.kind.name)));
        }
        if let Some(own) = self.own_hash(&here).filter(|own| !there.kind.hash.is_empty() && *own != here.kind.hash) {
            let own = hex::encode(own);
            return Ok(Err(format!("its {} is another than the one known here, of hash {own}", here.kind.name)));
        }
        if let Some((_, standing)) = to.local.as_ref().filter(|(_, standing)| !standing.kind.agrees(&here.kind)) {
            return Ok(Err(format!("it is of another type than the {} of another server", standing.kind.name)));
        }
        let converters = match self.types.service_converters(&here, there) {
            Ok(converters) => Mutex::new(converters),
            Err(error) => return Ok(Err(error.to_string())),
        };
        if to.local.is_none() {
            let name = here.kind.name.clone();
            match Stands::new(to.graph, &self.config.name, self.config.what, &here) {
                Ok(stands) => to.local = Some((Arc::new(stands), here)),
                Err(error @ GraphError::Left) => return Err(error.into()),
                // An earlier one may still be answering.
                Err(error) => return Ok(Err(error.to_string())),
            }
            self.is_up(&name);
        }
        Ok(Ok(Arc::new(Known { instance, epoch, converters })))
    }

    /// Of a type of this graph's dialect, as this proxy itself knows it.
    fn own_hash(&self, here: &Description) -> Option<Vec<u8>> {
        let kind = gdp_ros::roster::Kind { hash: vec![], ..here.kind.clone() };
        let hash = match self.config.what {
            What::Service => self.types.describe_service(kind).kind.hash,
            What::Action => self.types.describe_action(kind.name).kind.hash,
        };
        Some(hash).filter(|hash| !hash.is_empty())
    }

    /// A local client asks.
    async fn begin<'a>(
        &'a self,
        to: &In<'a>,
        local: Arc<Stands>,
        part: Part,
        asked: Asked,
        doing: &mut FuturesUnordered<Doing<'a>>,
    ) {
        let targets = match self.targets(to, part, &asked.request) {
            // What stops a robot finds room.
            Ok(_) if doing.len() >= MAX_PENDING && part != Part::CancelGoal => {
                Err(Failure::new(FailureCode::Busy, "too many wait here"))
            }
            targets => targets,
        };
        let Asked { request, mut asker } = asked;
        let (client, goals) = (to.client, to.goals);
        let is_new = matches!(&targets, Ok((_, true)));
        let targets = targets.map(|(targets, _)| targets);
        doing.push(Box::pin(async move {
            let _pending = self.counters.begun();
            let answer = async {
                let targets = targets?;
                match part {
                    Part::CancelGoal if targets.len() > 1 => cancel(client, &targets, &request).await,
                    Part::GetResult if targets.len() > 1 => first_result(client, &targets, &request).await,
                    _ => call(client, targets.first().ok_or_else(no_server)?, part, request.clone()).await,
                }
            };
            let answer = tokio::select! {
                answer = answer => answer,
                () = asker.hangs_up() => return Done::Call,
            };
            let goal = cdr::goal_of(&request).unwrap_or(cdr::ANY_GOAL);
            match (part, &answer) {
                (Part::SendGoal, Ok(response)) if cdr::is_accepted(response).unwrap_or_default() => {}
                // Another request may have begun it before.
                (Part::SendGoal, _) if is_new => lock(goals).forget(&goal),
                (Part::GetResult, Ok(_)) => lock(goals).end(Instant::now(), &goal),
                _ => {}
            }
            let mut changed = None;
            let answered = match answer {
                Ok(response) => {
                    self.counters.answered();
                    local.answer(part, asker, response).await
                }
                Err(Failed { failure, reason, instance }) => {
                    self.failed(reason, &failure);
                    changed = instance.filter(|_| reason == Reason::Changed);
                    local.refuse(part, asker, failure.to_string()).await
                }
            };
            if let Err(error) = answered {
                self.failed(Reason::Unanswered, error);
            }
            changed.map_or(Done::Call, Done::Changed)
        }));
    }

    /// Whom a request is for: most often one server. And whether it begins a goal that was not known.
    fn targets(&self, to: &In<'_>, part: Part, request: &[u8]) -> Result<(Vec<Arc<Known>>, bool), Failure> {
        let known = |name: &Name| match to.remotes.get(name) {
            Some(Remote::Known(known)) => Some(known.clone()),
            _ => None,
        };
        // The nearest first.
        let all: Vec<_> = to.client.instances().iter().filter_map(|one| known(&one.name)).collect();
        if part == Part::Service {
            return Ok((all.into_iter().take(1).collect(), false));
        }
        let malformed = |error| Failure::new(FailureCode::Malformed, error);
        let (goal, mut goals): (GoalId, _) = (cdr::goal_of(request).map_err(malformed)?, lock(to.goals));
        match (part, goals.get(&goal)) {
            // What was begun at one is continued there.
            (_, Some(of)) => Ok((known(&of).into_iter().collect(), false)),
            (Part::SendGoal, None) => {
                let nearest: Vec<_> = all.into_iter().take(1).collect();
                for one in &nearest {
                    goals.begin(goal, one.instance).map_err(|error| Failure::new(FailureCode::Busy, error))?;
                }
                Ok((nearest, true))
            }
            // Of all goals, or one that was sent before this proxy was started, perhaps.
            (_, None) => Ok((all, false)),
        }
    }

    async fn publish(&self, to: &mut In<'_>, instance: Name, events: Events) {
        self.counters.events(events.events.len() as u64, events.dropped);
        for event in events.events {
            let published = match event {
                Event::Feedback(message) => match (&to.local, cdr::goal_of(&message)) {
                    (_, Err(error)) => Err(error.to_string()),
                    (_, Ok(goal)) if lock(to.goals).get(&goal).is_some_and(|of| of != instance) => {
                        Err("feedback about a goal that another server has".into())
                    }
                    (Some((local, _)), Ok(_)) => local.publish_feedback(message).await,
                    (None, Ok(_)) => Ok(()),
                },
                Event::Status(message) => match to.board.say(instance, &message) {
                    Ok(ended) => {
                        let now = Instant::now();
                        let is_own = |goal: &GoalId| lock(to.goals).get(goal) == Some(instance);
                        let own = ended.iter().map(|status| status.goal).filter(is_own);
                        let own: Vec<GoalId> = own.collect();
                        own.iter().for_each(|goal| lock(to.goals).end(now, goal));
                        self.show(to).await;
                        Ok(())
                    }
                    Err(error) => Err(error.to_string()),
                },
            };
            if let Err(error) = published {
                self.failed(Reason::Malformed, error);
            }
        }
    }

    async fn show(&self, to: &In<'_>) {
        if let Some((local, _)) = &to.local
            && let Err(error) = local.publish_status(to.board.message()).await
        {
            self.failed(Reason::Unanswered, error);
        }
    }
}

async fn next(local: Option<&Stands>) -> Result<(Part, Asked), String> {
    match local {
        Some(local) => local.next().await,
        None => std::future::pending().await,
    }
}

/// Why a call has no answer, and of whom.
struct Failed {
    failure: Failure,
    reason: Reason,
    instance: Option<Name>,
}

impl From<Failure> for Failed {
    fn from(failure: Failure) -> Self {
        Self { reason: failure.code.into(), failure, instance: None }
    }
}

fn no_server() -> Failed {
    Failure::new(FailureCode::Gone, "it is not attached any more").into()
}

async fn ask(client: &Client, instance: Name, request: &Request) -> Result<Reply, NodeError> {
    let message = client.call_at(instance, CALL, &request.to_bytes()).await?;
    let reply = if message.encoding == CALL { Reply::from_bytes(&message.body).ok() } else { None };
    reply.ok_or(NodeError::Protocol("a reply that no proxy of this release sends"))
}

/// Asks again and again, which does no harm: the way to a server that has only just come may not be open yet, and the first to go by it may be
/// lost. So no call is.
async fn describe(client: &Client, instance: Name) -> Result<(Epoch, Description), String> {
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

/// After a pause.
fn ask_for_events(client: &Client, known: Arc<Known>, after: u64, pause: Duration) -> Doing<'_> {
    Box::pin(async move {
        if !pause.is_zero() {
            tokio::time::sleep(pause).await;
        }
        let request = Request::Events { epoch: known.epoch, after };
        let told = match tokio::time::timeout(PATIENCE, ask(client, known.instance, &request)).await {
            Err(_) => Err("no answer".to_owned()),
            Ok(Ok(Reply::Events(events))) => Ok(events),
            Ok(Ok(Reply::Failure(failure))) if failure.code == FailureCode::Changed => {
                return Done::Changed(known.instance);
            }
            Ok(Ok(Reply::Failure(failure))) => Err(failure.to_string()),
            Ok(Ok(Reply::Answer(_) | Reply::Description(..))) => Err("it answered another question".into()),
            Ok(Err(error)) => Err(error.to_string()),
        };
        Done::Events(known, after, told)
    })
}

/// Asks one server, for as long as it takes.
async fn call(client: &Client, known: &Known, part: Part, request: Bytes) -> Result<Bytes, Failed> {
    let instance = Some(known.instance);
    let failed = |reason, code, why: String| Failed { failure: Failure::new(code, why), reason, instance };
    let unconvertible = |error: String| failed(Reason::Unconvertible, FailureCode::Malformed, error);
    let body = lock(&known.converters).request.convert(request).map_err(|error| unconvertible(error.to_string()))?;
    let reply = ask(client, known.instance, &Request::Call { epoch: known.epoch, part, body }).await;
    match reply {
        Ok(Reply::Answer(body)) => {
            lock(&known.converters).response.convert(body).map_err(|error| unconvertible(error.to_string()))
        }
        Ok(Reply::Failure(failure)) => Err(Failed { reason: failure.code.into(), failure, instance }),
        Ok(Reply::Description(..) | Reply::Events(_)) => {
            Err(failed(Reason::Malformed, FailureCode::Malformed, "it answered another question".into()))
        }
        Err(error) => {
            let reason = match error {
                NodeError::InstanceLeft { .. } | NodeError::NoInstance { .. } => Reason::Left,
                NodeError::TooManyCalls(_) => Reason::Busy,
                NodeError::Protocol(_) => Reason::Malformed,
                _ => Reason::SendFailed,
            };
            Err(failed(reason, FailureCode::Gone, error.to_string()))
        }
    }
}

/// Asks all of them to cancel, and answers for all.
async fn cancel(client: &Client, targets: &[Arc<Known>], request: &Bytes) -> Result<Bytes, Failed> {
    let asked = targets.iter().map(|known| call(client, known, Part::CancelGoal, request.clone()));
    let (mut answers, mut failed) = (Vec::new(), None);
    for answer in join_all(asked).await {
        match answer.map(|answer| cdr::Canceling::read(&answer)) {
            Ok(Ok(answer)) => answers.push(answer),
            Ok(Err(error)) => failed = Some(Failure::new(FailureCode::Malformed, error).into()),
            Err(error) => failed = Some(error),
        }
    }
    let merged = cdr::Canceling::merge(answers).map(|merged| merged.write());
    merged.ok_or_else(|| failed.unwrap_or_else(no_server))
}

/// Asks all of them for the result of a goal, of which one may know.
async fn first_result(client: &Client, targets: &[Arc<Known>], request: &Bytes) -> Result<Bytes, Failed> {
    let asked = targets.iter().map(|known| call(client, known, Part::GetResult, request.clone()));
    let mut asked: FuturesUnordered<_> = asked.collect();
    let mut last = Err(no_server());
    while let Some(answer) = asked.next().await {
        match answer {
            Ok(answer) if cdr::result_status(&answer) != Ok(cdr::UNKNOWN) => return Ok(answer),
            answer => last = if last.is_ok() { last } else { answer },
        }
    }
    last
}
