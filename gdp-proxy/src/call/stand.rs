//! The proxy's own service or action server in the local graph, on behalf of remote servers.

use bytes::Bytes;
use gdp_ros::call::{Description, Part};
use gdp_ros::types::Types;

use crate::config::What;
use crate::graph::{ActionStand, Asked, Asker, Graph, GraphError, Stand};
use crate::ros2::TopicName;

pub enum Stands {
    Service(Stand),
    Action(ActionStand),
}

impl Stands {
    /// Creates the server. Local clients see it until it is dropped.
    pub fn new(
        graph: &Graph,
        types: &Types,
        name: &TopicName,
        what: What,
        here: &Description,
    ) -> Result<Self, GraphError> {
        match what {
            What::Service => Ok(Self::Service(Stand::new(graph, name, here)?)),
            What::Action => Ok(Self::Action(ActionStand::new(graph, types, name, here)?)),
        }
    }

    /// Shows the server as one of the node with this full name, where the graph can.
    pub fn assign(&self, node: &str) {
        match self {
            Self::Service(service) => service.assign(node),
            Self::Action(action) => action.assign(node),
        }
    }

    /// Waits for the next request. An `Err` explains why a request is invalid. Safe to cancel.
    pub async fn next(&self) -> Result<(Part, Asked), String> {
        match self {
            Self::Service(service) => Ok((Part::Service, service.next().await?)),
            Self::Action(action) => action.next().await,
        }
    }

    pub async fn answer(&self, part: Part, asker: Asker, response: Bytes) -> Result<(), String> {
        match self {
            Self::Service(service) => service.answer(asker, response).await,
            Self::Action(action) => action.answer(part, asker, response).await,
        }
    }

    /// Refuses a request. The clients of an action are informed in its own messages; of services,
    /// only those of ROS 1 are.
    pub async fn refuse(&self, part: Part, asker: Asker, why: String) -> Result<(), String> {
        match self {
            Self::Service(_) => {
                asker.refuse(why);
                Ok(())
            }
            Self::Action(action) => action.refuse(part, asker, &why).await,
        }
    }

    /// Waits without a timeout until the readers have all answers and published messages.
    pub async fn settle(&self) {
        match self {
            Self::Service(service) => service.settle().await,
            Self::Action(action) => action.settle().await,
        }
    }

    pub async fn publish_feedback(&self, message: Bytes) -> Result<(), String> {
        match self {
            Self::Service(_) => Ok(()),
            Self::Action(action) => action.publish_feedback(message).await,
        }
    }

    pub async fn publish_status(&self, message: Bytes) -> Result<(), String> {
        match self {
            Self::Service(_) => Ok(()),
            Self::Action(action) => action.publish_status(message).await,
        }
    }
}
