//! The proxy's own service or action server in the local graph, on behalf of remote servers.

use gdp_util::unix_time::unix_nanos;

use bytes::Bytes;
use gdp_ros::action::cdr;
use gdp_ros::call::{Description, Part};
use tokio::sync::Mutex;

use crate::config::What;
use crate::graph::{Asked, Asker, Graph, GraphError, Stand};
use crate::ros2::{self, Qos, RawSample, RawWriter, RosError, TopicName, TypeName};

pub enum Stands {
    Service(Stand),
    Action(Box<Action>),
}

pub struct Action {
    send_goal: Stand,
    cancel_goal: Stand,
    get_result: Stand,
    feedback: Mutex<RawWriter>,
    status: Mutex<RawWriter>,
}

impl Stands {
    /// Creates the server. Local clients see it until it is dropped.
    pub fn new(graph: &Graph, name: &TopicName, what: What, here: &Description) -> Result<Self, GraphError> {
        let domain = match (what, graph) {
            (What::Service, _) => return Ok(Self::Service(Stand::new(graph, name, here)?)),
            (What::Action, Graph::Ros2(domain)) => domain,
            (What::Action, Graph::Ros1(_)) => return Err(GraphError::Left),
        };
        let kind = TypeName::parse(&here.kind.name).map_err(RosError::from)?;
        let parts = ros2::Action::new(name, &kind).map_err(RosError::from)?;
        let server = |(name, kind): &(_, _)| domain.server(name, kind, None).map(|server| Stand::Ros2(server.into()));
        let writer = |(name, kind): &(_, _), qos: Qos| domain.writer(name, kind, &qos.into()).map(Mutex::new);
        // The topics come first, because clients that see the services expect them.
        let (feedback, status) = (
            writer(&parts.feedback, ros2::Action::feedback_qos())?,
            writer(&parts.status, ros2::Action::status_qos())?,
        );
        let (send_goal, cancel_goal, get_result) =
            (server(&parts.send_goal)?, server(&parts.cancel_goal)?, server(&parts.get_result)?);
        Ok(Self::Action(Box::new(Action { send_goal, cancel_goal, get_result, feedback, status })))
    }

    /// Shows the server as one of the node with this full name, where the graph can.
    pub fn assign(&self, node: &str) {
        match self {
            Self::Service(service) => service.assign(node),
            Self::Action(action) => {
                let Action { send_goal, cancel_goal, get_result, feedback, status } = &**action;
                [send_goal, cancel_goal, get_result].into_iter().for_each(|stand| stand.assign(node));
                // Nobody writes yet.
                [feedback, status]
                    .into_iter()
                    .filter_map(|writer| writer.try_lock().ok())
                    .for_each(|it| it.assign(node));
            }
        }
    }

    /// Waits for the next request. An `Err` explains why a request is invalid. Safe to cancel.
    pub async fn next(&self) -> Result<(Part, Asked), String> {
        let action = match self {
            Self::Service(service) => return Ok((Part::Service, service.next().await?)),
            Self::Action(action) => action,
        };
        tokio::select! {
            asked = action.send_goal.next() => Ok((Part::SendGoal, asked?)),
            asked = action.cancel_goal.next() => Ok((Part::CancelGoal, asked?)),
            asked = action.get_result.next() => Ok((Part::GetResult, asked?)),
        }
    }

    pub async fn answer(&self, part: Part, asker: Asker, response: Bytes) -> Result<(), String> {
        let stand = match (self, part) {
            (Self::Service(service), _) => service,
            (Self::Action(action), Part::CancelGoal) => &action.cancel_goal,
            (Self::Action(action), Part::GetResult) => &action.get_result,
            (Self::Action(action), Part::SendGoal | Part::Service) => &action.send_goal,
        };
        stand.answer(asker, response).await
    }

    /// Refuses a request. The clients of an action are informed in its own messages; of services,
    /// only those of ROS 1 are.
    pub async fn refuse(&self, part: Part, asker: Asker, why: String) -> Result<(), String> {
        let response = match part {
            Part::Service => {
                asker.refuse(why);
                return Ok(());
            }
            Part::SendGoal => cdr::rejected(),
            Part::CancelGoal => cdr::not_canceling(),
            Part::GetResult => cdr::aborted(),
        };
        self.answer(part, asker, response).await
    }

    /// Waits without a timeout until the readers have all answers and published messages.
    pub async fn settle(&self) {
        match self {
            Self::Service(service) => service.settle().await,
            Self::Action(action) => {
                let Action { send_goal, cancel_goal, get_result, feedback: _, status } = &**action;
                let status = async { status.lock().await.settle().await };
                tokio::join!(send_goal.settle(), cancel_goal.settle(), get_result.settle(), status);
            }
        }
    }

    pub async fn publish_feedback(&self, message: Bytes) -> Result<(), String> {
        match self {
            Self::Service(_) => Ok(()),
            Self::Action(action) => publish(&action.feedback, message).await,
        }
    }

    pub async fn publish_status(&self, message: Bytes) -> Result<(), String> {
        match self {
            Self::Service(_) => Ok(()),
            Self::Action(action) => publish(&action.status, message).await,
        }
    }
}

async fn publish(writer: &Mutex<RawWriter>, message: Bytes) -> Result<(), String> {
    let sample = RawSample::parse(message).ok_or("not a CDR encapsulation that ROS 2 uses")?;
    let now = unix_nanos();
    writer.lock().await.write(sample, now).await.map_err(|error| error.to_string())
}
