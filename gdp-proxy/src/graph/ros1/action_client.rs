//! A client of one action server at a ROS 1 master, on behalf of remote clients.

use std::time::{Duration, Instant};

use bytes::Bytes;
use gdp_ros::action::{GoalId, cdr};
use gdp_ros::actionlib::message::GoalStatus;
use gdp_ros::actionlib::{Accepted, GoalClient, GoalOutcome, message, status};
use gdp_ros::actions::{ActionTypes, Ros1Message};
use gdp_ros::call::{Event, Failure, FailureCode};
use gdp_ros::types::Types;
use gdp_ros1::{
    Message, MessageType, Node, NodeError, PublishOptions, Publisher, SourceState, SourceStates, SubscribeOptions,
    Subscription,
};
use parking_lot::Mutex;
use tokio::sync::watch;
use tokio::time::timeout;

use super::actions::{Ticks, kind, next, now};
use crate::graph::event::GraphError;
use crate::graph::services::{CallerError, MATCHED};
use crate::offload::run_blocking_if_large;
use crate::ros2::TopicName;

/// Interval in which the connections to a server are looked at until it is connected.
const LOOK: Duration = Duration::from_millis(20);

/// Interval in which expired goals are removed.
const SWEEP: Duration = Duration::from_secs(1);

pub struct ActionClient {
    /// The server's node.
    server: String,
    types: ActionTypes,
    goal: Publisher,
    cancel: Publisher,
    status: tokio::sync::Mutex<Subscription>,
    feedback: tokio::sync::Mutex<Subscription>,
    result: tokio::sync::Mutex<Subscription>,
    /// The publishers of the topics `status`, `feedback` and `result`.
    sources: [watch::Receiver<SourceStates>; 3],
    goals: Mutex<GoalClient>,
    /// Notified when the state of any goal has changed.
    changes: watch::Sender<()>,
    sweep: Ticks,
}

impl ActionClient {
    /// Connects to the action server at the node `server`. Waits until all its topics are
    /// connected, because the first messages would be lost otherwise.
    pub async fn new(node: &Node, types: &Types, name: &TopicName, server: &str) -> Result<Self, CallerError> {
        let mut graph = node.graph();
        graph.changes().await.ok_or(GraphError::Left)?;
        let kind = kind(graph.snapshot(), name.as_str()).ok_or(CallerError::NoActionType)?;
        let types = types.action(kind.as_str(), None)?;
        let client = Self::join(node, types, name, server)?;
        let connected = async {
            while !client.is_connected()? {
                tokio::time::sleep(LOOK).await;
            }
            Ok::<(), CallerError>(())
        };
        timeout(MATCHED, connected).await.map_err(|_| CallerError::Unmatched)??;
        Ok(client)
    }

    fn join(node: &Node, types: ActionTypes, name: &TopicName, server: &str) -> Result<Self, NodeError> {
        let publish =
            |part: &str, kind| node.publish(&format!("{name}/{part}"), message_type(kind), PublishOptions::default());
        // Any type, so that an error can name what differs.
        let subscribe = |part: &str| node.subscribe(&format!("{name}/{part}"), SubscribeOptions::default());
        let (goal, cancel) = (publish("goal", &types.goal)?, publish("cancel", &types.cancel)?);
        let (status, feedback, result) = (subscribe("status")?, subscribe("feedback")?, subscribe("result")?);
        let sources = [status.sources(), feedback.sources(), result.sources()];
        let [status, feedback, result] = [status, feedback, result].map(tokio::sync::Mutex::new);
        let (goals, changes) = (Mutex::new(GoalClient::new(node.name())), watch::channel(()).0);
        let (server, sweep) = (server.to_owned(), Ticks::every(SWEEP));
        Ok(Self { server, types, goal, cancel, status, feedback, result, sources, goals, changes, sweep })
    }

    pub fn types(&self) -> &ActionTypes {
        &self.types
    }

    fn is_connected(&self) -> Result<bool, CallerError> {
        let [_, feedback, result] = &self.sources;
        for (sources, ours) in [(feedback, &self.types.feedback), (result, &self.types.result)] {
            if let Some(theirs) = md5sum(&sources.borrow(), &self.server).filter(|theirs| *theirs != ours.md5sum) {
                return Err(CallerError::OtherAction { name: ours.name.clone(), theirs, ours: ours.md5sum.clone() });
            }
        }
        let hears = |publisher: &Publisher| publisher.subscribers().iter().any(|it| it.caller_id == self.server);
        let is_heard = self.sources.iter().all(|sources| md5sum(&sources.borrow(), &self.server).is_some());
        Ok(is_heard && hears(&self.goal) && hears(&self.cancel))
    }

    /// Waits until the server is not connected any more.
    pub async fn until_lost(&self) {
        let mut status = self.sources[0].clone();
        // An error means that the node has left.
        _ = status.wait_for(|sources| md5sum(sources, &self.server).is_none()).await;
    }

    /// Sends a goal, and waits until the server accepts or rejects it. Request and response are
    /// those of `send_goal`.
    pub async fn send_goal(&self, request: &[u8]) -> Result<Bytes, Failure> {
        let goal = cdr::goal_of(request).map_err(malformed)?;
        let body = run_blocking_if_large(request.len(), || self.types.goal_to_ros1(request)).map_err(malformed)?;
        let id = self.goals.lock().begin(Instant::now(), goal);
        let id = id.map_err(|error| Failure::new(FailureCode::Busy, error))?;
        let message = message::write_goal(now(), &id, &body);
        if let Err(error) = self.goal.publish(message) {
            self.goals.lock().forget(&goal);
            return Err(malformed(error));
        }
        match self.until(|goals| goals.accepted(&goal)).await {
            Accepted::Yes(stamp) => Ok(cdr::accepted(stamp)),
            Accepted::No => Ok(cdr::rejected()),
            Accepted::Lost => Err(Failure::new(FailureCode::Refused, "it has not answered the goal")),
        }
    }

    /// Cancels goals. Request and response are those of `cancel_goal`.
    pub fn cancel_goal(&self, request: &[u8]) -> Result<Bytes, Failure> {
        let (goal, stamp) = cdr::cancel_of(request).map_err(malformed)?;
        let (id, canceling) = self.goals.lock().cancel(goal, stamp);
        if let Some(id) = id {
            self.cancel.publish(message::write_cancel(&id)).map_err(malformed)?;
        }
        Ok(canceling.write())
    }

    /// Waits for the result of a goal without a timeout. Request and response are those of
    /// `get_result`.
    pub async fn get_result(&self, request: &[u8]) -> Result<Bytes, Failure> {
        let goal = cdr::goal_of(request).map_err(malformed)?;
        match self.until(|goals| goals.outcome(&goal)).await {
            GoalOutcome::Result(_, response) => Ok(response),
            GoalOutcome::Unknown => Ok(cdr::unknown()),
            GoalOutcome::Lost => Err(Failure::new(FailureCode::Refused, "it has ended the goal without a result")),
        }
    }

    async fn until<T>(&self, mut condition: impl FnMut(&GoalClient) -> Option<T>) -> T {
        let mut changes = self.changes.subscribe();
        loop {
            if let Some(value) = condition(&self.goals.lock()) {
                return value;
            }
            // The sender lives as long as `self`.
            _ = changes.changed().await;
        }
    }

    /// Waits for feedback, or for a change of the goals' statuses. Safe to cancel.
    pub async fn next_event(&self) -> Result<Event, String> {
        loop {
            let event = tokio::select! {
                message = next(&self.status) => self.take_statuses(&message),
                message = next(&self.feedback) => self.take_feedback(&message),
                message = next(&self.result) => self.take_result(&message),
                () = self.sweep.next() => {
                    self.goals.lock().sweep(Instant::now());
                    Ok(None)
                }
            };
            if let Some(event) = event? {
                return Ok(event);
            }
        }
    }

    fn take_statuses(&self, message: &Message) -> Result<Option<Event>, String> {
        if message.publisher.caller_id != self.server {
            return Ok(None);
        }
        let statuses = message::read_statuses(&message.data).map_err(|error| error.to_string())?;
        let has_changed = self.goals.lock().take_statuses(Instant::now(), &statuses);
        Ok(has_changed.then(|| self.changed()))
    }

    fn take_feedback(&self, message: &Message) -> Result<Option<Event>, String> {
        let Some((goal, _, feedback)) = self.update(message, &self.types.feedback)? else { return Ok(None) };
        let convert = || self.types.feedback_to_ros2(&goal, &feedback);
        let feedback = run_blocking_if_large(feedback.len(), convert).map_err(|error| error.to_string())?;
        Ok(Some(Event::Feedback(feedback)))
    }

    fn take_result(&self, message: &Message) -> Result<Option<Event>, String> {
        let Some((goal, status, result)) = self.update(message, &self.types.result)? else { return Ok(None) };
        let convert = || self.types.result_to_ros2(status::to_ros2(status::of_result(status.status)), &result);
        match run_blocking_if_large(result.len(), convert) {
            Ok(result) => self.goals.lock().take_result(Instant::now(), &goal, &status, result),
            Err(error) => {
                self.goals.lock().lose(Instant::now(), &goal);
                self.changed();
                return Err(error.to_string());
            }
        }
        Ok(Some(self.changed()))
    }

    /// Reads a message about a goal of this client: the goal, its status, and the rest.
    fn update(&self, message: &Message, kind: &Ros1Message) -> Result<Option<(GoalId, GoalStatus, Bytes)>, String> {
        let publisher = &message.publisher;
        if publisher.caller_id != self.server {
            return Ok(None);
        }
        if publisher.md5sum != kind.md5sum {
            return Err(format!("{} has another definition of {}", publisher.caller_id, kind.name));
        }
        let (status, rest) = message::read_update(&message.data).map_err(|error| error.to_string())?;
        let goal = self.goals.lock().goal(&status.goal.id);
        Ok(goal.map(|goal| (goal, status, rest)))
    }

    /// Notifies those who wait for goals. Returns the statuses as an event.
    fn changed(&self) -> Event {
        self.changes.send_replace(());
        Event::Status(cdr::status_array(&self.goals.lock().statuses(Instant::now())))
    }
}

/// Returns the MD5 sum that the node announces, if it is connected.
fn md5sum(sources: &SourceStates, node: &str) -> Option<String> {
    sources.values().find_map(|source| match source {
        SourceState::Connected(publisher) if publisher.caller_id == node => Some(publisher.md5sum.clone()),
        _ => None,
    })
}

pub fn message_type(message: &Ros1Message) -> MessageType {
    let Ros1Message { name, md5sum, definition } = message;
    MessageType { name: name.clone(), md5sum: md5sum.clone(), definition: definition.clone() }
}

fn malformed(error: impl ToString) -> Failure {
    Failure::new(FailureCode::Malformed, error)
}
