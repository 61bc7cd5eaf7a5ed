//! Actions of a ROS graph, of either ROS version: calls to a local server, and servers on behalf of
//! remote ones. Requests, responses and messages are in the form of ROS 2.

use bytes::Bytes;
use gdp_ros::action::cdr;
use gdp_ros::call::{Description, Event, Failure, FailureCode, Part};
use gdp_ros::roster::{Dialect, Kind};
use gdp_ros::types::Types;
use gdp_util::unix_time::unix_nanos;
use tokio::sync::Mutex;

use super::ros1::{ActionClient, ActionServer};
use super::services::{Asked, Asker, Caller, CallerError, Peer, Stand};
use super::{Graph, GraphError, zenoh};
use crate::ros2::{self, Qos, RawReader, RawSample, RawWriter, RosError, TopicName, TypeName};

/// A client of a local action server.
pub enum ActionCaller {
    Ros1(Box<ActionClient>),
    Ros2(Box<Ros2Caller>),
}

pub struct Ros2Caller {
    send_goal: Caller,
    cancel_goal: Caller,
    get_result: Caller,
    feedback: PartReader,
    status: PartReader,
}

/// A reader of a topic of an action.
enum PartReader {
    Dds(Box<RawReader>),
    Zenoh(Box<zenoh::ZenohFeed>),
}

/// An action server in the local graph, which exists until it is dropped.
pub enum ActionStand {
    Ros1(Box<ActionServer>),
    Ros2(Box<Ros2Stand>),
}

pub struct Ros2Stand {
    send_goal: Stand,
    cancel_goal: Stand,
    get_result: Stand,
    feedback: PartWriter,
    status: PartWriter,
}

/// A writer of a topic of an action.
enum PartWriter {
    Dds(Box<Mutex<RawWriter>>),
    Zenoh(Box<zenoh::ZenohWriter>),
}

impl ActionCaller {
    /// Connects to the local server. Waits until it can be called, and returns its description for
    /// remote clients.
    pub async fn new(
        graph: &Graph,
        types: &Types,
        name: &TopicName,
        peer: &Peer,
    ) -> Result<(Self, Description), CallerError> {
        match (graph, peer) {
            (Graph::Ros1(master), Peer::Ros1(server)) => {
                let client = ActionClient::new(master.node(), types, name, server).await?;
                let description = client.types().description.clone();
                Ok((Self::Ros1(client.into()), description))
            }
            (Graph::Ros2(domain), Peer::Ros2(peer)) => {
                let of = |error: ros2::NameError| GraphError::from(RosError::from(error));
                let parts = ros2::Action::new(name, &peer.kind).map_err(of)?;
                let reader = |(topic, kind): &(_, _), qos: Qos| domain.reader(topic, kind, &qos.into());
                let feedback = reader(&parts.feedback, ros2::Action::feedback_qos()).map_err(GraphError::from)?;
                let status = reader(&parts.status, ros2::Action::status_qos()).map_err(GraphError::from)?;
                let services =
                    [&parts.send_goal, &parts.cancel_goal, &parts.get_result].map(|(name, kind)| (name, kind));
                // Feedback that is published before its reader is matched is lost.
                let [send_goal, cancel_goal, get_result] =
                    Caller::several(domain, services, [&feedback, &status], peer).await?;
                let (feedback, status) = (PartReader::Dds(feedback.into()), PartReader::Dds(status.into()));
                let caller = Ros2Caller { send_goal, cancel_goal, get_result, feedback, status };
                Ok((Self::Ros2(caller.into()), types.describe_action(peer.kind.to_string())))
            }
            (Graph::Zenoh(graph), Peer::Ros2(peer)) => {
                let of = |error: ros2::NameError| GraphError::from(RosError::from(error));
                let parts = ros2::Action::new(name, &peer.kind).map_err(of)?;
                let feedback = graph.feed(&parts.feedback, ros2::Action::feedback_qos(), peer).await?;
                let status = graph.feed(&parts.status, ros2::Action::status_qos(), peer).await?;
                let (feedback, status) = (PartReader::Zenoh(feedback.into()), PartReader::Zenoh(status.into()));
                let client = async |(name, kind): &(_, _)| -> Result<Caller, CallerError> {
                    Ok(Caller::Zenoh(graph.client(name, kind, peer).await?.0.into()))
                };
                let send_goal = client(&parts.send_goal).await?;
                let (cancel_goal, get_result) = (client(&parts.cancel_goal).await?, client(&parts.get_result).await?);
                let caller = Ros2Caller { send_goal, cancel_goal, get_result, feedback, status };
                Ok((Self::Ros2(caller.into()), types.describe_action(peer.kind.to_string())))
            }
            _ => Err(GraphError::Left.into()),
        }
    }

    /// Calls the local server and waits for the answer without a timeout.
    pub async fn call(&self, part: Part, request: Bytes) -> Result<Bytes, Failure> {
        match (self, part) {
            (_, Part::Service) => {
                Err(Failure::new(FailureCode::Malformed, "the name is of an action, and not of a service"))
            }
            (Self::Ros1(client), Part::SendGoal) => client.send_goal(&request).await,
            (Self::Ros1(client), Part::CancelGoal) => client.cancel_goal(&request),
            (Self::Ros1(client), Part::GetResult) => client.get_result(&request).await,
            (Self::Ros2(caller), Part::SendGoal) => caller.send_goal.call(request).await,
            (Self::Ros2(caller), Part::CancelGoal) => caller.cancel_goal.call(request).await,
            (Self::Ros2(caller), Part::GetResult) => caller.get_result.call(request).await,
        }
    }

    /// Waits for feedback or status. Safe to cancel.
    pub async fn next_event(&self) -> Result<Event, String> {
        let caller = match self {
            Self::Ros1(client) => return client.next_event().await,
            Self::Ros2(caller) => caller,
        };
        tokio::select! {
            message = caller.feedback.next() => message.map(Event::Feedback),
            message = caller.status.next() => message.map(Event::Status),
        }
    }

    /// Waits until the server is lost although the graph may still show it. In ROS 2 the graph
    /// reports it, so this waits forever.
    pub async fn until_lost(&self) {
        match self {
            Self::Ros1(client) => client.until_lost().await,
            Self::Ros2(_) => std::future::pending().await,
        }
    }
}

impl ActionStand {
    /// Creates a server of an action, which another proxy has described.
    pub fn new(graph: &Graph, types: &Types, name: &TopicName, here: &Description) -> Result<Self, GraphError> {
        let domain = match graph {
            Graph::Ros2(domain) => domain,
            Graph::Zenoh(graph) => return Self::of_zenoh(graph, types, name, here),
            Graph::Ros1(master) => {
                let types = types.action(&here.kind.name, here.definitions.as_ref())?;
                return Ok(Self::Ros1(ActionServer::new(master.node(), types, name)?.into()));
            }
        };
        let kind = TypeName::parse(&here.kind.name).map_err(RosError::from)?;
        let parts = ros2::Action::new(name, &kind).map_err(RosError::from)?;
        let server = |(name, kind): &(_, _)| domain.server(name, kind, None).map(|server| Stand::Ros2(server.into()));
        let writer = |(name, kind): &(_, _), qos: Qos| {
            domain.writer(name, kind, &qos.into()).map(|writer| PartWriter::Dds(Mutex::new(writer).into()))
        };
        // The topics come first, because clients that see the services expect them.
        let (feedback, status) = (
            writer(&parts.feedback, ros2::Action::feedback_qos())?,
            writer(&parts.status, ros2::Action::status_qos())?,
        );
        let (send_goal, cancel_goal, get_result) =
            (server(&parts.send_goal)?, server(&parts.cancel_goal)?, server(&parts.get_result)?);
        Ok(Self::Ros2(Box::new(Ros2Stand { send_goal, cancel_goal, get_result, feedback, status })))
    }

    fn of_zenoh(
        graph: &zenoh::ZenohGraph,
        types: &Types,
        name: &TopicName,
        here: &Description,
    ) -> Result<Self, GraphError> {
        let kind = TypeName::parse(&here.kind.name).map_err(RosError::from)?;
        let parts = ros2::Action::new(name, &kind).map_err(RosError::from)?;
        let of = [&parts.send_goal, &parts.cancel_goal, &parts.get_result, &parts.feedback, &parts.status];
        let hashes = types.part_hashes(here, of.map(|(_, kind)| kind.as_str()));
        let [send_goal, cancel_goal, get_result, feedback, status] =
            hashes.map_err(|_| GraphError::NoHash(here.kind.name.clone()))?;
        let writer = |(name, kind): &(TopicName, TypeName), hash: &[u8], qos: Qos| {
            let kind = Kind { dialect: Dialect::Ros2, name: kind.to_string(), hash: vec![] };
            graph.writer(name, &kind, hash, qos.into()).map(|writer| PartWriter::Zenoh(writer.into()))
        };
        let server = |(name, kind): &(_, _), hash: &[u8]| {
            graph.server(name, kind, hash).map(|server| Stand::Zenoh(server.into()))
        };
        Ok(Self::Ros2(Box::new(Ros2Stand {
            feedback: writer(&parts.feedback, &feedback, ros2::Action::feedback_qos())?,
            status: writer(&parts.status, &status, ros2::Action::status_qos())?,
            send_goal: server(&parts.send_goal, &send_goal)?,
            cancel_goal: server(&parts.cancel_goal, &cancel_goal)?,
            get_result: server(&parts.get_result, &get_result)?,
        })))
    }

    /// Shows the server as one of the node with this full name. In ROS 1 it stays one of the proxy.
    pub fn assign(&self, node: &str) {
        let Self::Ros2(stand) = self else { return };
        let Ros2Stand { send_goal, cancel_goal, get_result, feedback, status } = &**stand;
        [send_goal, cancel_goal, get_result].into_iter().for_each(|stand| stand.assign(node));
        [feedback, status].into_iter().for_each(|sink| sink.assign(node));
    }

    /// Waits for the next request. An `Err` explains why a request is invalid. Safe to cancel.
    pub async fn next(&self) -> Result<(Part, Asked), String> {
        let stand = match self {
            Self::Ros1(server) => {
                let ask = server.next().await?;
                return Ok((ask.part, Asked { request: ask.request, asker: Asker::Goal(ask.goal) }));
            }
            Self::Ros2(stand) => stand,
        };
        tokio::select! {
            asked = stand.send_goal.next() => Ok((Part::SendGoal, asked?)),
            asked = stand.cancel_goal.next() => Ok((Part::CancelGoal, asked?)),
            asked = stand.get_result.next() => Ok((Part::GetResult, asked?)),
        }
    }

    /// Sends the response to the client.
    pub async fn answer(&self, part: Part, asker: Asker, response: Bytes) -> Result<(), String> {
        let stand = match (self, asker) {
            (Self::Ros1(server), Asker::Goal(goal)) => return server.answer(part, &goal, &response),
            (Self::Ros1(_), _) => return Err("a request of another server".into()),
            (Self::Ros2(stand), asker) => (stand, asker),
        };
        let (stand, asker) = stand;
        let stand = match part {
            Part::CancelGoal => &stand.cancel_goal,
            Part::GetResult => &stand.get_result,
            Part::SendGoal | Part::Service => &stand.send_goal,
        };
        stand.answer(asker, response).await
    }

    /// Refuses a request. Clients are informed in the action's own messages.
    pub async fn refuse(&self, part: Part, asker: Asker, why: &str) -> Result<(), String> {
        if let (Self::Ros1(server), Asker::Goal(goal)) = (self, &asker) {
            server.refuse(part, goal, why);
            return Ok(());
        }
        let response = match part {
            Part::SendGoal | Part::Service => cdr::rejected(),
            Part::CancelGoal => cdr::not_canceling(),
            Part::GetResult => cdr::aborted(),
        };
        self.answer(part, asker, response).await
    }

    /// Ends the goals in progress. Waits without a timeout until the readers have all answers and
    /// published messages.
    pub async fn settle(&self) {
        match self {
            Self::Ros1(server) => server.settle().await,
            Self::Ros2(stand) => {
                let Ros2Stand { send_goal, cancel_goal, get_result, feedback: _, status } = &**stand;
                tokio::join!(send_goal.settle(), cancel_goal.settle(), get_result.settle(), status.settle());
            }
        }
    }

    pub async fn publish_feedback(&self, message: Bytes) -> Result<(), String> {
        match self {
            Self::Ros1(server) => server.publish_feedback(&message),
            Self::Ros2(stand) => stand.feedback.publish(message).await,
        }
    }

    pub async fn publish_status(&self, message: Bytes) -> Result<(), String> {
        match self {
            Self::Ros1(server) => server.publish_status(&message),
            Self::Ros2(stand) => stand.status.publish(message).await,
        }
    }
}

impl PartReader {
    /// Waits for the next message. Safe to cancel.
    async fn next(&self) -> Result<Bytes, String> {
        match self {
            Self::Dds(reader) => {
                reader.recv().await.map(|message| message.sample.bytes).map_err(|error| error.to_string())
            }
            Self::Zenoh(feed) => feed.next().await,
        }
    }
}

impl PartWriter {
    fn assign(&self, node: &str) {
        match self {
            // Nobody writes yet.
            Self::Dds(writer) => {
                if let Ok(mut writer) = writer.try_lock() {
                    writer.assign(node);
                }
            }
            Self::Zenoh(writer) => writer.assign(node),
        }
    }

    async fn publish(&self, message: Bytes) -> Result<(), String> {
        let now = unix_nanos();
        match self {
            Self::Dds(writer) => {
                let sample = RawSample::parse(message).ok_or("not a CDR encapsulation that ROS 2 uses")?;
                writer.lock().await.write(sample, now).await.map_err(|error| error.to_string())
            }
            Self::Zenoh(writer) => writer.write(message, now).await.map_err(|error| error.to_string()),
        }
    }

    async fn settle(&self) {
        if let Self::Dds(writer) = self {
            writer.lock().await.settle().await;
        }
    }
}
