//! Servers elsewhere, for clients here. A server stands for them in the graph only while at least one of them is attached.

use std::collections::BTreeMap;
use std::pin::{Pin, pin};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use futures::StreamExt;
use futures::stream::FuturesUnordered;
use gdp::Name;
use gdp::cert::Reading;
use gdp::node::{Client, NodeError};
use gdp_ros::action::{Board, GoalId, Goals, cdr};
use gdp_ros::call::{Description, Epoch, Event, Events, Failure, FailureCode, Part};
use gdp_ros::services::service_name;
use tokio::sync::watch;

use super::asking::{self, Asking, Changed, Described, Failed, Known, News, describe};
use super::counters::Reason;
use super::outbox::Outbox;
use super::stand::Stands;
use super::{LAST_WORDS, MAX_PENDING, Route, Way, lock};
use crate::config::What;
use crate::graph::{Asked, GraphError};
use crate::standing::{Pause, Right, RouteError, ended_because, ticks};
use crate::turns::{Over, unless};

/// Servers elsewhere that are told apart; of more, the nearest.
const MAX_SERVERS: usize = 64;

/// Before a server is asked again that was of no use.
const ASK_AGAIN: Duration = Duration::from_secs(5);

/// A server elsewhere.
enum Remote {
    Asked,
    Known(Arc<Known>),
    /// It cannot be called, at least until then.
    Unfit(Instant),
}

/// What has come of something that was begun.
enum Done {
    Description(Name, Described),
    /// With the event that was had before.
    News(Arc<Known>, u64, News),
    /// Published here, if it was; and whether it is feedback.
    Said(bool, Result<(), String>),
}

type Doing<'a> = FuturesUnordered<Pin<Box<dyn Future<Output = Done> + Send + 'a>>>;

/// Calls, with the servers that were found to be others.
type Calls<'a> = FuturesUnordered<Pin<Box<dyn Future<Output = Vec<Changed>> + Send + 'a>>>;

/// What this side knows of all servers of the name.
struct In<'a> {
    way: &'a Way<'a>,
    client: &'a Client,
    remotes: BTreeMap<Name, Remote>,
    /// What stands for them, and what it is.
    local: Option<(Arc<Stands>, Description)>,
    goals: &'a Mutex<Goals<Name>>,
    board: Board,
    outbox: Outbox,
    /// Something of it is being published.
    is_speaking: bool,
    /// Who waits is to be told that it is in vain.
    is_leaving: watch::Receiver<bool>,
}

impl Route {
    pub(super) async fn run_in(
        &self,
        way: &Way<'_>,
        right: &mut Right<Reading>,
        mut over: Over<'_>,
    ) -> Result<(), RouteError> {
        let mut pause = Pause::new();
        loop {
            let error = match unless(&mut over, way.node.client(way.card.proof(), right.held())).await {
                None => return Ok(()),
                Some(Ok(client)) => {
                    pause = Pause::new();
                    way.place.set_permitted(true);
                    match self.carry_in(way, &client, right, &mut over).await? {
                        Some(error) => error,
                        None => return Ok(()),
                    }
                }
                Some(Err(error)) => error,
            };
            self.counters.servers(0);
            way.place.set_permitted(false);
            if unless(&mut over, self.standing.pause(error, &mut pause, right)).await.is_none() {
                return Ok(());
            }
        }
    }

    /// Returns when the right to call has ended, with the reason, or when the turn is over.
    async fn carry_in(
        &self,
        way: &Way<'_>,
        client: &Client,
        right: &mut Right<Reading>,
        over: &mut Over<'_>,
    ) -> Result<Option<NodeError>, RouteError> {
        let (leaving, is_leaving) = watch::channel(false);
        let goals = Mutex::new(Goals::default());
        let (remotes, local, board, outbox) = (BTreeMap::new(), None, Board::default(), Outbox::default());
        let mut to = In { way, client, remotes, local, goals: &goals, board, outbox, is_speaking: false, is_leaving };
        let (mut ticks, mut changes, mut ended) = (ticks(), client.changes(), pin!(client.ended()));
        changes.mark_changed();
        let (mut doing, mut calls) = (Doing::new(), Calls::new());
        self.standing.set_status("waiting for a server elsewhere");
        let why = loop {
            self.speak(&mut to, &doing);
            let local = to.local.as_ref().map(|(local, _)| local.clone());
            tokio::select! {
                Some(done) = doing.next() => self.done(&mut to, done, &doing)?,
                Some(changed) = calls.next() => {
                    for changed in changed {
                        self.changed(&mut to, changed, &doing)?;
                    }
                }
                asked = next(local.as_deref()) => match (asked, local) {
                    (Ok((part, asked)), Some(local)) => self.begin(&to, local, part, asked, &calls),
                    (Err(error), _) => self.failed(Reason::Malformed, error),
                    (Ok(_), None) => {}
                },
                Ok(()) = changes.changed() => self.look(&mut to, &doing),
                why = &mut ended => break Some(why),
                () = &mut *over => break None,
                _ = ticks.tick() => {
                    self.standing.renew(right, async |new| client.renew(new).await).await;
                    let now = Instant::now();
                    lock(to.goals).sweep(now);
                    if to.board.sweep(now) {
                        to.show();
                    }
                    self.look(&mut to, &doing);
                }
            }
        };
        // What is being published is not waited for.
        doing.clear();
        leaving.send_replace(true);
        _ = tokio::time::timeout(LAST_WORDS, self.take_leave(&mut to, &mut calls)).await;
        why.map(ended_because).transpose()
    }

    /// Who waits is told that it is in vain, and whose goals are under way that they are lost.
    async fn take_leave(&self, to: &mut In<'_>, calls: &mut Calls<'_>) {
        while calls.next().await.is_some() {}
        let (now, board) = (Instant::now(), &mut to.board);
        let lost = to.remotes.keys().filter(|name| board.leave(now, name)).count();
        let Some((local, _)) = &to.local else { return };
        if lost > 0
            && let Err(error) = local.publish_status(to.board.message()).await
        {
            self.failed(Reason::Unanswered, error);
        }
        local.settle().await;
    }

    /// Compares the servers that are attached with those that are known.
    fn look<'a>(&'a self, to: &mut In<'a>, doing: &Doing<'a>) {
        let now = Instant::now();
        // What another proxy of this graph serves, clients here have without this one.
        let instances = to.client.instances().into_iter().filter(|one| !to.way.place.is_twin(now, &one.name));
        let attached: Vec<Name> = instances.take(MAX_SERVERS).map(|one| one.name).collect();
        let gone: Vec<Name> = to.remotes.keys().filter(|name| !attached.contains(name)).copied().collect();
        for name in gone {
            to.remotes.remove(&name);
            // Those who ask for results are told as their calls fail.
            to.lose_goals(now, name);
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
        let is_unfit = to.remotes.values().any(|remote| matches!(remote, Remote::Unfit(_)));
        // Another proxy of the graph may know more.
        to.way.place.set_permitted(known > 0 || !is_unfit);
        self.counters.servers(known);
        if known == 0 && to.local.take().is_some() {
            tracing::info!(service = %self.config.name, "no server elsewhere is left, so it is not announced here any more");
            self.standing.set_status("waiting for a server elsewhere");
        }
    }

    fn done<'a>(&'a self, to: &mut In<'a>, done: Done, doing: &Doing<'a>) -> Result<(), RouteError> {
        match done {
            Done::Said(is_feedback, said) => {
                to.is_speaking = false;
                match said {
                    Ok(()) => self.counters.events(1, 0),
                    Err(error) if is_feedback => {
                        self.counters.events(0, 1);
                        tracing::debug!(service = %self.config.name, "feedback was not published: {error}");
                    }
                    Err(error) => self.failed(Reason::Unanswered, error),
                }
            }
            Done::Description(name, described) => {
                if matches!(to.remotes.get(&name), Some(Remote::Asked)) {
                    self.described(to, name, described, doing)?;
                }
            }
            Done::News(known, after, news) => {
                if !to.knows(&known) {
                    return Ok(());
                }
                let (after, has_failed) = match news {
                    News::Events(events) => {
                        let last = events.last;
                        self.hear(to, known.instance, events);
                        (last, false)
                    }
                    News::None(error) => {
                        tracing::debug!(service = %self.config.name, server = %known.instance, "no events: {error}");
                        (after, true)
                    }
                    News::Changed(changed) => return self.changed(to, changed, doing),
                };
                doing.push(ask_for_events(to.client, known, after, has_failed));
            }
        }
        Ok(())
    }

    /// A server is another, unless it is known by now that it is.
    fn changed<'a>(&'a self, to: &mut In<'a>, changed: Changed, doing: &Doing<'a>) -> Result<(), RouteError> {
        let Changed { known, now } = changed;
        if !to.knows(&known) {
            return Ok(());
        }
        to.lose_goals(Instant::now(), known.instance);
        let is_same = now.as_ref().is_ok_and(|(epoch, _)| *epoch == known.epoch);
        let now = if is_same { Err("it says that it is another, and that it is the same".into()) } else { now };
        self.described(to, known.instance, now, doing)
    }

    fn described<'a>(
        &'a self,
        to: &mut In<'a>,
        name: Name,
        described: Described,
        doing: &Doing<'a>,
    ) -> Result<(), RouteError> {
        let fit = match described {
            Ok((epoch, there)) => self.fit(to, name, epoch, there)?,
            Err(error) => Err(error),
        };
        match fit {
            Ok(known) => {
                to.remotes.insert(name, Remote::Known(known.clone()));
                if self.config.what == What::Action {
                    doing.push(ask_for_events(to.client, known, 0, false));
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
        self.withdraw_if_alone(to);
        Ok(())
    }

    /// Whether a server can be called as what stands for it here, which is made if it is the first. The outer error is the graph's.
    fn fit(
        &self,
        to: &mut In<'_>,
        instance: Name,
        epoch: Epoch,
        there: Description,
    ) -> Result<Result<Arc<Known>, String>, RouteError> {
        let dialect = to.way.graph.dialect();
        let here = match (self.config.what, there.kind.dialect == dialect) {
            (What::Service, _) => self.types.service_counterpart(&there, dialect),
            (What::Action, true) => Ok(there.clone()),
            (What::Action, false) => return Ok(Err("it is an action of ROS 1, which are topics".into())),
        };
        let here = match here {
            Ok(here) => here,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let wanted = to.way.kind.map(|kind| match self.config.what {
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
        let converters = match self.types.service_converters(&here, &there) {
            Ok(converters) => Mutex::new(converters),
            Err(error) => return Ok(Err(error.to_string())),
        };
        if to.local.is_none() {
            let name = here.kind.name.clone();
            match Stands::new(to.way.graph, &self.config.name, self.config.what, &here) {
                Ok(stands) => to.local = Some((Arc::new(stands), here)),
                Err(error @ GraphError::Left) => return Err(error.into()),
                // An earlier one may still be answering.
                Err(error) => return Ok(Err(error.to_string())),
            }
            self.is_up(&name);
        }
        Ok(Ok(Arc::new(Known { instance, epoch, there, converters })))
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
    fn begin<'a>(&'a self, to: &In<'a>, local: Arc<Stands>, part: Part, asked: Asked, calls: &Calls<'a>) {
        let targets = match self.targets(to, part, &asked.request) {
            // What stops a robot finds room.
            Ok(_) if calls.len() >= MAX_PENDING && part != Part::CancelGoal => {
                Err(Failure::new(FailureCode::Busy, "too many wait here"))
            }
            targets => targets,
        };
        let Asked { request, mut asker } = asked;
        let (client, goals, mut is_leaving) = (to.client, to.goals, to.is_leaving.clone());
        calls.push(Box::pin(async move {
            let _pending = self.counters.begun();
            let goal = cdr::goal_of(&request).unwrap_or(cdr::ANY_GOAL);
            let is_new = matches!(&targets, Ok((_, true)));
            let asking = Asking::new(client, part, request);
            let answer = async {
                let (targets, _) = targets?;
                asking.answer(&targets).await
            };
            let answer = tokio::select! {
                answer = answer => Some(answer),
                () = asker.hangs_up() => None,
                _ = is_leaving.wait_for(|leaving| *leaving) => {
                    Some(Err(Failure::new(FailureCode::Gone, "this proxy carries no calls any more").into()))
                }
            };
            match (part, &answer) {
                (Part::SendGoal, Some(Ok(response))) if cdr::is_accepted(response).unwrap_or_default() => {}
                // Another request may have begun it before.
                (Part::SendGoal, _) if is_new => lock(goals).forget(&goal),
                (Part::GetResult, Some(Ok(_))) => lock(goals).end(Instant::now(), &goal),
                _ => {}
            }
            let answered = match answer {
                None => Ok(()),
                Some(Ok(response)) => {
                    self.counters.answered();
                    local.answer(part, asker, response).await
                }
                Some(Err(Failed { failure, reason })) => {
                    self.failed(reason, &failure);
                    local.refuse(part, asker, failure.to_string()).await
                }
            };
            if let Err(error) = answered {
                self.failed(Reason::Unanswered, error);
            }
            asking.changed()
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

    /// What a server says of goals is to be published here.
    fn hear(&self, to: &mut In<'_>, instance: Name, events: Events) {
        self.counters.events(0, events.dropped);
        for event in events.events {
            let taken = match event {
                Event::Feedback(message) => match cdr::goal_of(&message) {
                    Err(error) => Err(error.to_string()),
                    Ok(goal) if lock(to.goals).get(&goal).is_some_and(|of| of != instance) => {
                        Err("feedback about a goal that another server has".into())
                    }
                    Ok(_) => {
                        self.counters.events(0, to.outbox.feedback(message));
                        Ok(())
                    }
                },
                Event::Status(message) => match to.board.say(instance, &message) {
                    Ok(ended) => {
                        let (now, mut goals) = (Instant::now(), lock(to.goals));
                        for cdr::Status { goal, .. } in ended {
                            if goals.get(&goal) == Some(instance) {
                                goals.end(now, &goal);
                            }
                        }
                        drop(goals);
                        to.show();
                        Ok(())
                    }
                    Err(error) => Err(error.to_string()),
                },
            };
            if let Err(error) = taken {
                self.failed(Reason::Malformed, error);
            }
        }
    }

    /// Begins to publish what is next, once what was before is published: a subscriber that does not keep up delays nothing else.
    fn speak<'a>(&self, to: &mut In<'a>, doing: &Doing<'a>) {
        if to.is_speaking {
            return;
        }
        let (Some(event), Some((local, _))) = (to.outbox.next(), &to.local) else { return };
        let local = local.clone();
        to.is_speaking = true;
        doing.push(Box::pin(async move {
            match event {
                Event::Feedback(message) => Done::Said(true, local.publish_feedback(message).await),
                Event::Status(message) => Done::Said(false, local.publish_status(message).await),
            }
        }));
    }
}

impl In<'_> {
    fn knows(&self, known: &Arc<Known>) -> bool {
        matches!(self.remotes.get(&known.instance), Some(Remote::Known(now)) if Arc::ptr_eq(now, known))
    }

    /// Those that a server has, or had.
    fn lose_goals(&mut self, now: Instant, server: Name) {
        lock(self.goals).end_all(now, server);
        if self.board.leave(now, &server) {
            self.show();
        }
    }

    fn show(&mut self) {
        self.outbox.status(self.board.message());
    }
}

async fn next(local: Option<&Stands>) -> Result<(Part, Asked), String> {
    match local {
        Some(local) => local.next().await,
        None => std::future::pending().await,
    }
}

fn ask_for_events(
    client: &Client,
    known: Arc<Known>,
    after: u64,
    has_failed: bool,
) -> Pin<Box<dyn Future<Output = Done> + Send + '_>> {
    Box::pin(async move {
        let news = asking::events(client, &known, after, has_failed).await;
        Done::News(known, after, news)
    })
}
