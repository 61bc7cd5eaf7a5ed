//! Remote servers for local clients. The proxy offers a server in the graph only while at least one
//! remote server is attached.

mod events;
mod requests;
mod servers;
mod state;

use crate::call::inward::events::{Doing, Done, Remote};
use crate::call::inward::state::In;
use std::collections::BTreeMap;
use std::pin::{Pin, pin};
use std::time::Instant;

use futures::StreamExt;
use futures::stream::FuturesUnordered;
use gdp::unstable::{Client, NodeError};
use gdp_core::cert::Reading;
use gdp_ros::action::{Board, Goals, cdr};
use gdp_ros::call::{Event, Events, Part};
use gdp_wire::Name;
use parking_lot::Mutex;
use tokio::sync::watch;

use super::asking::{Changed, News};
use super::counters::Reason;
use super::outbox::Outbox;
use super::stand::Stands;
use super::{LAST_WORDS, Route, Way};
use crate::graph::Asked;
use crate::route_status::{RETRY, Right, RouteError, ended_because, ticks};
use crate::turns::unless;
use crate::waiting::Waiting;
use servers::{ask_for_events, withdraw};

/// Pending calls, each of which returns the servers that were found to have changed.
type Calls<'a> = FuturesUnordered<Pin<Box<dyn Future<Output = Vec<Changed>> + Send + 'a>>>;

impl Route {
    pub(super) async fn run_in(
        &self,
        way: &Way<'_>,
        right: &mut Right<Reading>,
        mut over: Pin<&mut (impl Future<Output = ()> + Send)>,
    ) -> Result<(), RouteError> {
        let mut pause = RETRY;
        loop {
            let error = match unless(&mut over, way.node.client(way.card.proof(), right.current())).await {
                None => return Ok(()),
                Some(Ok(client)) => {
                    pause = RETRY;
                    way.candidate.set_permitted(!self.leaves_to_others(Instant::now()));
                    match self.carry_in(way, &client, right, &mut over).await? {
                        Some(error) => error,
                        None => return Ok(()),
                    }
                }
                Some(Err(error)) => error,
            };
            self.counters.servers(0);
            way.candidate.set_permitted(false);
            if unless(&mut over, self.route_status.pause(error, &mut pause, right)).await.is_none() {
                return Ok(());
            }
        }
    }

    /// Carries calls until the right to call ends, and returns the reason; or until the turn is
    /// over, and returns `None`.
    async fn carry_in(
        &self,
        way: &Way<'_>,
        client: &Client,
        right: &mut Right<Reading>,
        over: &mut (impl Future<Output = ()> + Send + Unpin),
    ) -> Result<Option<NodeError>, RouteError> {
        let (leaving, is_leaving) = watch::channel(false);
        let goals = Mutex::new(Goals::default());
        let (remotes, local, board, outbox) = (BTreeMap::new(), None, Board::default(), Outbox::default());
        let mut to = In { way, client, remotes, local, goals: &goals, board, outbox, is_speaking: false, is_leaving };
        let (mut ticks, mut changes, mut ended) = (ticks(), client.changes(), pin!(client.ended()));
        changes.mark_changed();
        let (mut doing, mut calls) = (Doing::new(), Calls::new());
        self.route_status.set_status(Waiting::RemoteServer.as_str());
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
                    self.route_status.renew(right, async |new| client.renew(new).await).await;
                    let now = Instant::now();
                    to.goals.lock().sweep(now);
                    if to.board.sweep(now) {
                        to.show();
                    }
                    self.look(&mut to, &doing);
                }
            }
        };
        // Publications in progress are not awaited.
        doing.clear();
        leaving.send_replace(true);
        _ = tokio::time::timeout(LAST_WORDS, self.take_leave(&mut to, &mut calls)).await;
        why.map(ended_because).transpose()
    }

    /// Sends failures to the waiting clients, and reports goals in progress as lost.
    async fn take_leave(&self, to: &mut In<'_>, calls: &mut Calls<'_>) {
        while calls.next().await.is_some() {}
        let now = Instant::now();
        for name in to.remotes.keys() {
            to.board.leave(now, name);
        }
        if let Some((local, _)) = to.local.take()
            && let Err(error) = withdraw(local, to.board.message()).await
        {
            self.failed(Reason::Unanswered, error);
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
            Done::Withdrawn(Ok(())) => {}
            Done::Withdrawn(Err(error)) => self.failed(Reason::Unanswered, error),
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

    /// Queues the events of a remote server for publication in the local graph.
    fn hear(&self, to: &mut In<'_>, instance: Name, events: Events) {
        self.counters.events(0, events.dropped);
        for event in events.events {
            let taken = match event {
                Event::Feedback(message) => match cdr::goal_of(&message) {
                    Err(error) => Err(error.to_string()),
                    Ok(goal) if to.goals.lock().get(&goal).is_some_and(|of| of != instance) => {
                        Err("feedback about a goal that another server has".into())
                    }
                    Ok(_) => {
                        self.counters.events(0, to.outbox.feedback(message));
                        Ok(())
                    }
                },
                Event::Status(message) => match to.board.say(instance, &message) {
                    Ok(ended) => {
                        let (now, mut goals) = (Instant::now(), to.goals.lock());
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

    /// Starts to publish the next event once the one before is published. So a slow subscriber
    /// delays only the events.
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

async fn next(local: Option<&Stands>) -> Result<(Part, Asked), String> {
    match local {
        Some(local) => local.next().await,
        None => std::future::pending().await,
    }
}
