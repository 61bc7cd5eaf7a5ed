//! Forwards the requests of local clients to a remote server.

use std::sync::Arc;
use std::time::Instant;

use gdp_ros::action::{GoalId, cdr};
use gdp_ros::call::{Failure, FailureCode, Part};
use gdp_wire::Name;

use super::super::MAX_PENDING;
use super::super::asking::{Asking, Failed, Known};
use super::super::counters::Reason;
use super::super::stand::Stands;
use super::{Calls, Route};
use crate::call::inward::events::Remote;
use crate::call::inward::state::In;
use crate::graph::Asked;

impl Route {
    /// Starts to forward the request of a local client.
    pub(super) fn begin<'a>(&'a self, to: &In<'a>, local: Arc<Stands>, part: Part, asked: Asked, calls: &Calls<'a>) {
        // A cancellation always finds room, because it stops a robot.
        let targets = match calls.len() >= MAX_PENDING && part != Part::CancelGoal {
            true => Err(Failure::new(FailureCode::Busy, "too many wait here")),
            false => self.targets(to, part, &asked.request),
        };
        let Asked { request, mut asker } = asked;
        let (client, goals, mut is_leaving) = (to.client, to.goals, to.is_leaving.clone());
        calls.push(Box::pin(async move {
            let _pending = self.counters.begun();
            let goal = cdr::goal_of(&request).unwrap_or(cdr::ANY_GOAL);
            let is_new = matches!(&targets, Ok((_, true)));
            let asking = Asking::new(client, part, request);
            if matches!(&targets, Ok((targets, _)) if part == Part::Service && targets.len() > 1) {
                self.counters.replicated();
            }
            let answer = async {
                let (targets, _) = targets?;
                asking.answer(&targets).await
            };
            let answer = tokio::select! {
                answer = answer => Some(answer),
                () = asker.hangs_up() => None,
                _ = is_leaving.wait_for(|leaving| *leaving) => {
                    Some(Err(Failure::new(FailureCode::ServerLeft, "this proxy carries no calls any more").into()))
                }
            };
            match (part, &answer) {
                (Part::SendGoal, Some(Ok(response))) if cdr::is_accepted(response).unwrap_or_default() => {}
                // An earlier request may have begun the goal.
                (Part::SendGoal, _) if is_new => goals.lock().forget(&goal),
                (Part::GetResult, Some(Ok(_))) => goals.lock().end(Instant::now(), &goal),
                _ => {}
            }
            let answered = match answer {
                None => Ok(()),
                Some(Ok(response)) => {
                    self.counters.answered();
                    if asking.copies.is_won_by_other() {
                        self.counters.answered_by_other();
                    }
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
            self.counters.copies_cancelled(asking.copies.cancel(client).await);
            asking.changed()
        }));
    }

    /// Returns the servers for a request, usually one, and whether the request begins an unknown
    /// goal. A call of a service goes to as many as `replicate` says.
    fn targets(&self, to: &In<'_>, part: Part, request: &[u8]) -> Result<(Vec<Arc<Known>>, bool), Failure> {
        let known = |name: &Name| match to.remotes.get(name) {
            Some(Remote::Known(known)) => Some(known.clone()),
            _ => None,
        };
        // In order of distance, nearest first.
        let all: Vec<_> = to.client.instances().iter().filter_map(|one| known(&one.name)).collect();
        if part == Part::Service {
            return Ok((all.into_iter().take(self.config.copies()).collect(), false));
        }
        let malformed = |error| Failure::new(FailureCode::Malformed, error);
        let (goal, mut goals): (GoalId, _) = (cdr::goal_of(request).map_err(malformed)?, to.goals.lock());
        match (part, goals.get(&goal)) {
            // Requests about a goal go to the server where it began.
            (_, Some(of)) => Ok((known(&of).into_iter().collect(), false)),
            (Part::SendGoal, None) => {
                let nearest: Vec<_> = all.into_iter().take(1).collect();
                for one in &nearest {
                    goals.begin(goal, one.instance).map_err(|error| Failure::new(FailureCode::Busy, error))?;
                }
                Ok((nearest, true))
            }
            // The request is about all goals, or about one that began before this proxy started.
            (_, None) => Ok((all, false)),
        }
    }
}
