//! An action server at a ROS 1 master, on behalf of a remote server.

use std::time::{Duration, Instant};

use gdp_core::crypto::random;
use gdp_ros::action::{GoalId, cdr};
use gdp_ros::actionlib::message::{self, GoalStatus, Time};
use gdp_ros::actionlib::{Ask, Ended, GoalServer, Taken, status};
use gdp_ros::actions::{ActionTypes, Ros1Message};
use gdp_ros::call::Part;
use gdp_ros1::{Message, Node, NodeError, PublishOptions, Publisher, SubscribeOptions, Subscription};
use parking_lot::Mutex;
use tokio::sync::Notify;

use super::action_client::message_type;
use super::actions::{Ticks, next, now};
use super::is_proxy;
use crate::offload::run_blocking_if_large;
use crate::ros2::TopicName;

/// Interval in which the statuses of all goals are published, as actionlib does it.
const STATUS: Duration = Duration::from_millis(200);

/// Time for the last messages to be sent, because a publisher that is dropped discards what it has
/// queued.
const FLUSH: Duration = Duration::from_millis(300);

/// An action server, which exists until it is dropped.
pub struct ActionServer {
    node: String,
    types: ActionTypes,
    goal: tokio::sync::Mutex<Subscription>,
    cancel: tokio::sync::Mutex<Subscription>,
    status: Publisher,
    feedback: Publisher,
    result: Publisher,
    goals: Mutex<GoalServer>,
    /// Notified when there is a request to send.
    asks: Notify,
    ticks: Ticks,
}

impl ActionServer {
    /// Creates a server. All its topics are at one node, because clients require it.
    pub fn new(node: &Node, types: ActionTypes, name: &TopicName) -> Result<Self, NodeError> {
        let subscribe = |part: &str, kind: &Ros1Message| {
            let kind = Some((kind.name.clone(), kind.md5sum.clone()));
            node.subscribe(&format!("{name}/{part}"), SubscribeOptions { kind, ..SubscribeOptions::default() })
        };
        let publish = |part: &str, kind: &Ros1Message, latch| {
            let options = PublishOptions { latch, ..PublishOptions::default() };
            node.publish(&format!("{name}/{part}"), message_type(kind), options)
        };
        let (goal, cancel) = (subscribe("goal", &types.goal)?, subscribe("cancel", &types.cancel)?);
        let (feedback, result) =
            (publish("feedback", &types.feedback, false)?, publish("result", &types.result, false)?);
        let status = publish("status", &types.status, true)?;
        let [goal, cancel] = [goal, cancel].map(tokio::sync::Mutex::new);
        Ok(Self {
            node: node.name().to_owned(),
            types,
            goal,
            cancel,
            status,
            feedback,
            result,
            goals: Mutex::default(),
            asks: Notify::new(),
            ticks: Ticks::every(STATUS),
        })
    }

    /// Waits for the next request to the remote server. An `Err` explains why a message is invalid.
    /// Safe to cancel.
    pub async fn next(&self) -> Result<Ask, String> {
        loop {
            if let Some(ask) = self.goals.lock().next_ask() {
                return Ok(ask);
            }
            tokio::select! {
                message = next(&self.goal) => self.take_goal(&message)?,
                message = next(&self.cancel) => self.take_cancel(&message)?,
                () = self.asks.notified() => {}
                () = self.ticks.next() => self.tick(),
            }
        }
    }

    fn take_goal(&self, message: &Message) -> Result<(), String> {
        if is_proxy(&message.publisher.caller_id) {
            return Ok(());
        }
        let (mut id, body) = message::read_goal(&message.data).map_err(|error| error.to_string())?;
        let (goal, wall): (GoalId, _) = (random().map_err(|error| error.to_string())?, now());
        if id.id.is_empty() {
            id.id = format!("{}-{}", self.node, hex::encode(goal));
        }
        if id.stamp == Time::default() {
            id.stamp = wall;
        }
        let taken = self.goals.lock().take_goal(id, goal);
        match taken {
            Taken::Known => return Ok(()),
            Taken::Ended(ended) => self.publish_ended(Some(ended)),
            Taken::New => match run_blocking_if_large(body.len(), || self.types.goal_to_ros2(&goal, &body)) {
                Ok(request) => self.goals.lock().send(goal, request),
                Err(error) => {
                    self.end(&goal, status::REJECTED, &error.to_string());
                    return Err(error.to_string());
                }
            },
        }
        self.publish_list();
        Ok(())
    }

    fn take_cancel(&self, message: &Message) -> Result<(), String> {
        if is_proxy(&message.publisher.caller_id) {
            return Ok(());
        }
        let canceled = message::read_cancel(&message.data).map_err(|error| error.to_string())?;
        self.goals.lock().cancel(Instant::now(), canceled);
        Ok(())
    }

    fn tick(&self) {
        let instant = Instant::now();
        let due = self.goals.lock().due(instant);
        for ended in due {
            self.publish_ended(Some(ended));
        }
        self.goals.lock().sweep(instant);
        self.publish_list();
    }

    /// Takes the response of the remote server to a request about a goal.
    pub fn answer(&self, part: Part, goal: &GoalId, response: &[u8]) -> Result<(), String> {
        match part {
            Part::SendGoal if cdr::is_accepted(response).map_err(|error| error.to_string())? => {
                self.goals.lock().accepted(goal);
                self.asks.notify_one();
            }
            Part::SendGoal => self.end(goal, status::REJECTED, "the server has rejected it"),
            Part::GetResult if cdr::result_status(response) == Ok(cdr::UNKNOWN) => {
                self.end(goal, status::ABORTED, "the server does not know it");
            }
            Part::GetResult => match run_blocking_if_large(response.len(), || self.types.result_to_ros1(response)) {
                Ok((status, result)) => {
                    let ended = self.goals.lock().take_result(Instant::now(), goal, status, result);
                    self.publish_ended(ended);
                }
                Err(error) => {
                    self.end(goal, status::ABORTED, &error.to_string());
                    return Err(error.to_string());
                }
            },
            Part::CancelGoal | Part::Service => {}
        }
        Ok(())
    }

    /// Ends a goal whose request has failed. A failed cancellation changes nothing.
    pub fn refuse(&self, part: Part, goal: &GoalId, why: &str) {
        match part {
            Part::SendGoal => self.end(goal, status::REJECTED, why),
            Part::GetResult => self.end(goal, status::ABORTED, why),
            Part::CancelGoal | Part::Service => {}
        }
    }

    /// Aborts all goals, because the remote server has left. Waits until clients know it.
    pub async fn settle(&self) {
        let ended = self.goals.lock().end_all(Instant::now(), status::ABORTED, "the server has gone");
        for ended in ended {
            self.publish_ended(Some(ended));
        }
        tokio::time::sleep(FLUSH).await;
    }

    /// Publishes a feedback message of ROS 2, if its goal is of a local client.
    pub fn publish_feedback(&self, message: &[u8]) -> Result<(), String> {
        let goal = cdr::goal_of(message).map_err(|error| error.to_string())?;
        let Some(status) = self.goals.lock().live(&goal) else { return Ok(()) };
        let feedback = run_blocking_if_large(message.len(), || self.types.feedback_to_ros1(message));
        let feedback = feedback.map_err(|error| error.to_string())?;
        let message = message::write_update(now(), &status, &feedback);
        self.feedback.publish(message).map_err(|error| error.to_string())
    }

    /// Takes a status list of ROS 2, and publishes what has changed.
    pub fn publish_status(&self, message: &[u8]) -> Result<(), String> {
        let statuses = cdr::statuses(message).map_err(|error| error.to_string())?;
        let (ended, has_changed) = self.goals.lock().take_statuses(Instant::now(), &statuses);
        for ended in ended {
            self.publish_ended(Some(ended));
        }
        if has_changed {
            self.publish_list();
        }
        Ok(())
    }

    fn end(&self, goal: &GoalId, status: u8, text: &str) {
        let ended = self.goals.lock().end(Instant::now(), goal, status, text);
        self.publish_ended(ended);
    }

    /// Publishes the result before the list, as actionlib does it.
    fn publish_ended(&self, ended: Option<Ended>) {
        let Some(Ended { status, result }) = ended else { return };
        let result = result.unwrap_or_else(|| self.types.empty_result());
        let message = message::write_update(now(), &status, &result);
        if let Err(error) = self.result.publish(message) {
            tracing::warn!(goal = status.goal.id, "the result was not published: {error}");
        }
        self.publish_list();
    }

    fn publish_list(&self) {
        let list: Vec<GoalStatus> = self.goals.lock().list();
        let message = message::write_statuses(now(), &list);
        if let Err(error) = self.status.publish(message) {
            tracing::warn!("the statuses of goals were not published: {error}");
        }
    }
}
