//! The local servers behind a name that remote clients call.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp::unstable::Call;
use gdp_ros::action::{Goals, Log, cdr};
use gdp_ros::call::{Description, Event, Events, Failure, FailureCode, Part};
use gdp_ros::types::Types;
use gdp_wire::Name;
use parking_lot::Mutex;

use crate::graph::{ActionCaller, Caller, CallerError, Graph, Peer};
use crate::ros2;

/// Time for which a request for events stays open without events. A link may have lost the answer,
/// or the client may be gone.
const QUESTION_LIFETIME: Duration = Duration::from_secs(60);

pub enum Backend {
    Service(Caller),
    Action(Box<Action>),
}

pub struct Action {
    server: ActionCaller,
    goals: Mutex<Goals<Name>>,
    log: Mutex<Log>,
    /// Open requests for events by client, each with the last event that the client has and the
    /// time of the request.
    questions: Mutex<HashMap<Name, (Call, u64, Instant)>>,
}

/// A request for events, with its answer.
pub type CallEvents = (Call, Events);

impl Backend {
    /// Connects to the local server. Waits until it can be called, and returns its description for
    /// remote clients.
    pub async fn new(
        graph: &Graph,
        types: &Types,
        name: &ros2::TopicName,
        peer: &Peer,
        is_action: bool,
    ) -> Result<(Self, Description), CallerError> {
        if !is_action {
            let (caller, kind) = Caller::new(graph, name, peer).await?;
            return Ok((Self::Service(caller), types.describe_service(kind)));
        }
        let (server, description) = ActionCaller::new(graph, types, name, peer).await?;
        let (goals, log, questions) = Default::default();
        Ok((Self::Action(Action { server, goals, log, questions }.into()), description))
    }

    /// Calls the local server and waits for the answer without a timeout.
    pub async fn call(&self, part: Part, caller: Name, body: Bytes) -> Result<Bytes, Failure> {
        match (self, part) {
            (Self::Service(service), Part::Service) => service.call(body).await,
            (Self::Action(action), Part::SendGoal) => action.send_goal(caller, body).await,
            (Self::Action(action), Part::GetResult) => action.get_result(body).await,
            (Self::Action(action), part) => action.server.call(part, body).await,
            (Self::Service(_), _) => {
                Err(Failure::new(FailureCode::Malformed, "the name is of a service, and not of an action"))
            }
        }
    }

    /// See [`Caller::has_lost_server`]. Actions return false; see [`Self::until_lost`].
    pub async fn has_lost_server(&self) -> bool {
        match self {
            Self::Service(service) => service.has_lost_server().await,
            Self::Action(_) => false,
        }
    }

    /// See [`ActionCaller::until_lost`]. For services it waits forever.
    pub async fn until_lost(&self) {
        match self {
            Self::Service(_) => std::future::pending().await,
            Self::Action(action) => action.server.until_lost().await,
        }
    }

    /// Waits for feedback or status of the action. Returns the answers to open requests for events,
    /// and the number of dropped feedback messages. Safe to cancel.
    pub async fn next_events(&self) -> Result<(Vec<CallEvents>, u64), String> {
        let Self::Action(action) = self else { return std::future::pending().await };
        match action.server.next_event().await? {
            Event::Feedback(message) => Ok(action.take_feedback(message)),
            Event::Status(message) => Ok((action.take_status(&message)?, 0)),
        }
    }

    /// Answers a request for events after event `after`, or leaves it open until there are some.
    pub fn ask(&self, call: Call, after: u64) -> Result<Option<CallEvents>, Box<(Call, Failure)>> {
        let Self::Action(action) = self else {
            let failure = Failure::new(FailureCode::Malformed, "the name is of a service, and services have no events");
            return Err(Box::new((call, failure)));
        };
        let (caller, now) = (call.client(), Instant::now());
        if let Err(error) = action.log.lock().add_caller(now, caller) {
            return Err(Box::new((call, Failure::new(FailureCode::Busy, error))));
        }
        match action.log.lock().after(&caller, after) {
            Some(events) => Ok(Some((call, events))),
            None => {
                action.questions.lock().insert(caller, (call, after, now));
                Ok(None)
            }
        }
    }

    /// Removes expired goals and logs. Returns the requests that were open for too long, with an
    /// empty answer.
    pub fn sweep(&self) -> Vec<CallEvents> {
        let (Self::Action(action), now) = (self, Instant::now()) else { return vec![] };
        let mut goals = action.goals.lock();
        goals.sweep(now);
        action.log.lock().sweep(now, |caller| goals.has_live(*caller));
        let mut questions = action.questions.lock();
        let over =
            questions.iter().filter(|(_, (_, _, since))| now.saturating_duration_since(*since) >= QUESTION_LIFETIME);
        let over: Vec<Name> = over.map(|(caller, _)| *caller).collect();
        let over = over.iter().filter_map(|caller| questions.remove(caller));
        over.map(|(call, last, _)| (call, Events { last, ..Events::default() })).collect()
    }
}

impl Action {
    async fn send_goal(&self, caller: Name, body: Bytes) -> Result<Bytes, Failure> {
        let goal = cdr::goal_of(&body).map_err(|error| Failure::new(FailureCode::Malformed, error))?;
        self.log.lock().add_caller(Instant::now(), caller).map_err(|error| Failure::new(FailureCode::Busy, error))?;
        // Feedback of the goal may arrive before the answer.
        let is_new = {
            let mut goals = self.goals.lock();
            let is_new = goals.get(&goal).is_none();
            goals.begin(goal, caller).map_err(|error| Failure::new(FailureCode::Busy, error))?;
            is_new
        };
        let answer = self.server.call(Part::SendGoal, body).await;
        if is_new && !answer.as_ref().is_ok_and(|answer| cdr::is_accepted(answer).unwrap_or_default()) {
            self.goals.lock().forget(&goal);
        }
        answer
    }

    async fn get_result(&self, body: Bytes) -> Result<Bytes, Failure> {
        let goal = cdr::goal_of(&body).map_err(|error| Failure::new(FailureCode::Malformed, error))?;
        let answer = self.server.call(Part::GetResult, body).await?;
        self.goals.lock().end(Instant::now(), &goal);
        Ok(answer)
    }

    fn take_feedback(&self, message: Bytes) -> (Vec<CallEvents>, u64) {
        // Goals of local clients and of other proxies belong to no remote client.
        let caller = cdr::goal_of(&message).ok().and_then(|goal| self.goals.lock().get(&goal));
        let Some(caller) = caller else { return (vec![], 0) };
        let dropped = self.log.lock().feedback(&caller, message);
        (self.tell(&caller).into_iter().collect(), dropped)
    }

    fn take_status(&self, message: &[u8]) -> Result<Vec<CallEvents>, String> {
        let statuses = cdr::statuses(message).map_err(|error| error.to_string())?;
        let (now, mut goals, mut log) = (Instant::now(), self.goals.lock(), self.log.lock());
        let callers: Vec<Name> = log.callers().copied().collect();
        for caller in &callers {
            let own = statuses.iter().filter(|status| goals.get(&status.goal) == Some(*caller)).copied();
            log.status(caller, cdr::status_array(&own.collect::<Vec<_>>()));
        }
        statuses.iter().filter(|status| status.is_final()).for_each(|status| goals.end(now, &status.goal));
        drop((goals, log));
        Ok(callers.iter().filter_map(|caller| self.tell(caller)).collect())
    }

    /// Answers the client's open request for events, if there is one.
    fn tell(&self, caller: &Name) -> Option<CallEvents> {
        let mut questions = self.questions.lock();
        let (_, after, _) = questions.get(caller)?;
        let events = self.log.lock().after(caller, *after)?;
        questions.remove(caller).map(|(call, ..)| (call, events))
    }
}
