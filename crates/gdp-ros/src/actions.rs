//! Definitions of action types, and the conversion of their messages between the ROS versions.
//!
//! Proxies exchange actions in the form of ROS 2. A proxy at a ROS 1 master converts.

use bytes::Bytes;
use gdp_msg::{Action, ActionPart, Mapping, Options, Registry, Schema, TranscodeError, TypeName, hash};

use crate::action::GoalId;
use crate::action::cdr::ANY_GOAL;
use crate::call::{Definitions, Description};
use crate::roster::{Dialect, Kind, MAX_DEFINITION};
use crate::services::rihs01;
use crate::types::{TypeError, Types};

/// Length of the encapsulation header of CDR.
const ENCAPSULATION: usize = 4;

/// The messages of an action in both ROS versions.
pub struct ActionTypes {
    /// The description for other proxies.
    pub description: Description,
    /// The messages of the topics `goal`, `result` and `feedback` in ROS 1.
    pub goal: Ros1Message,
    pub result: Ros1Message,
    pub feedback: Ros1Message,
    /// Those of the topics `cancel` and `status`, which all actions share.
    pub cancel: Ros1Message,
    pub status: Ros1Message,
    goals: Mappings,
    results: Mappings,
    feedbacks: Mappings,
    empty_result: Bytes,
}

/// A message type of ROS 1, as connection headers name it.
pub struct Ros1Message {
    /// Such as `pkg/DoActionGoal`.
    pub name: String,
    pub md5sum: String,
    pub definition: String,
}

struct Mappings {
    to_ros1: Mapping,
    to_ros2: Mapping,
}

/// The reason why a message of an action cannot be converted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConvertError {
    #[error(transparent)]
    Transcode(#[from] TranscodeError),
    #[error("a message of an action that ends too early")]
    Short,
}

impl Types {
    /// Describes an action type of ROS 2 from the local registry.
    pub fn describe_action(&self, name: String) -> Description {
        let schema =
            TypeName::parse(&name).ok().and_then(|name| Schema::resolve(&self.0, gdp_msg::Dialect::Ros2, &name).ok());
        describe(name, schema.as_deref())
    }

    /// Returns the messages of the action with this ROS 2 name. `definitions` are those that the
    /// server announced. Without them, the local registry must know the type, in either ROS
    /// version.
    pub fn action(&self, name: &str, definitions: Option<&Definitions>) -> Result<ActionTypes, TypeError> {
        let name = TypeName::parse(name)?;
        let action = match definitions {
            None => Action::resolve(&self.0, &name),
            Some(definitions) => {
                let mut registry: Registry = self.0.clone();
                let text = &definitions.request;
                registry.add_text(gdp_msg::Dialect::Ros2, &name, text).map_err(gdp_msg::SchemaError::from)?;
                Action::resolve(&registry, &name)
            }
        }?;
        let shared = |name: &str| -> Result<_, TypeError> {
            let schema = Schema::resolve(&self.0, gdp_msg::Dialect::Ros1, &TypeName::parse(name)?)?;
            Ok(Ros1Message::new(&schema))
        };
        ActionTypes::new(&action, shared("actionlib_msgs/GoalID")?, shared("actionlib_msgs/GoalStatusArray")?)
    }
}

impl Types {
    /// Returns the RIHS01 hashes of types that belong to an action of ROS 2, such as
    /// `pkg/action/Do_SendGoal`. Uses the announced definitions, or else the local registry.
    pub fn part_hashes<const N: usize>(
        &self,
        action: &Description,
        parts: [&str; N],
    ) -> Result<[Vec<u8>; N], TypeError> {
        let mut registry: Registry = self.0.clone();
        if let Some(definitions) = &action.definitions {
            let name = TypeName::parse(&action.kind.name)?;
            let text = &definitions.request;
            registry.add_text(gdp_msg::Dialect::Ros2, &name, text).map_err(gdp_msg::SchemaError::from)?;
        }
        let mut hashes = [const { Vec::new() }; N];
        for (hash, part) in hashes.iter_mut().zip(parts) {
            *hash = rihs01(&*Schema::resolve(&registry, gdp_msg::Dialect::Ros2, &TypeName::parse(part)?)?);
        }
        Ok(hashes)
    }
}

/// Describes an action for other proxies. The definition of the whole type takes the place of a
/// service's request.
fn describe(name: String, schema: Option<&Schema>) -> Description {
    let hash = schema.map(rihs01).unwrap_or_default();
    let text = schema.map(Schema::text).filter(|text| text.len() <= MAX_DEFINITION);
    let definitions = text.map(|request| Definitions { request, response: String::new() });
    Description { kind: Kind { dialect: Dialect::Ros2, name, hash }, node: String::new(), definitions }
}

impl ActionTypes {
    fn new(action: &Action, cancel: Ros1Message, status: Ros1Message) -> Result<Self, TypeError> {
        let message = |part| -> Result<_, TypeError> { Ok(Ros1Message::new(&*action.ros1(part)?)) };
        let mappings = |part| -> Result<_, TypeError> {
            let to_ros1 = action.mapping(part, gdp_msg::Dialect::Ros2)?;
            for note in to_ros1.notes() {
                tracing::info!(action = %action.name(), part = ?part, "from ROS 2 to ROS 1, {note}");
            }
            Ok(Mappings { to_ros1, to_ros2: action.mapping(part, gdp_msg::Dialect::Ros1)? })
        };
        Ok(Self {
            description: describe(action.name().to_string(), Some(&*action.ros2()?)),
            goal: message(ActionPart::Goal)?,
            result: message(ActionPart::Result)?,
            feedback: message(ActionPart::Feedback)?,
            cancel,
            status,
            goals: mappings(ActionPart::Goal)?,
            results: mappings(ActionPart::Result)?,
            feedbacks: mappings(ActionPart::Feedback)?,
            empty_result: action.empty_result()?.into(),
        })
    }

    /// Converts the goal in a request of `send_goal`.
    pub fn goal_to_ros1(&self, request: &[u8]) -> Result<Bytes, ConvertError> {
        without_id(request, &self.goals)
    }

    /// Converts a goal into a request of `send_goal`.
    pub fn goal_to_ros2(&self, id: &GoalId, goal: &[u8]) -> Result<Bytes, ConvertError> {
        with_id(id, goal, &self.goals)
    }

    /// Converts the feedback in a feedback message of ROS 2.
    pub fn feedback_to_ros1(&self, message: &[u8]) -> Result<Bytes, ConvertError> {
        without_id(message, &self.feedbacks)
    }

    /// Converts feedback into a feedback message of ROS 2.
    pub fn feedback_to_ros2(&self, id: &GoalId, feedback: &[u8]) -> Result<Bytes, ConvertError> {
        with_id(id, feedback, &self.feedbacks)
    }

    /// Converts a response of `get_result`. Returns its status and the result.
    pub fn result_to_ros1(&self, response: &[u8]) -> Result<(i8, Bytes), ConvertError> {
        let mut result = Bytes::from(transcode(&self.results.to_ros1, response)?);
        let status = if result.is_empty() { return Err(ConvertError::Short) } else { result.split_to(1) };
        Ok((status[0] as i8, result))
    }

    /// Converts a result into a response of `get_result`.
    pub fn result_to_ros2(&self, status: i8, result: &[u8]) -> Result<Bytes, ConvertError> {
        Ok(transcode(&self.results.to_ros2, &[&[status as u8][..], result].concat())?.into())
    }

    /// Returns a result of ROS 1 for a goal without one.
    pub fn empty_result(&self) -> Bytes {
        self.empty_result.clone()
    }
}

impl Ros1Message {
    fn new(schema: &Schema) -> Self {
        let name = schema.name().display(gdp_msg::Dialect::Ros1);
        Self { name, md5sum: hash::md5sum(schema), definition: schema.text() }
    }
}

/// A UUID in front keeps the alignment of what follows.
fn without_id(message: &[u8], mappings: &Mappings) -> Result<Bytes, ConvertError> {
    let (header, rest) = message.split_at_checked(ENCAPSULATION).ok_or(ConvertError::Short)?;
    let rest = rest.get(ANY_GOAL.len()..).ok_or(ConvertError::Short)?;
    Ok(transcode(&mappings.to_ros1, &[header, rest].concat())?.into())
}

fn with_id(id: &GoalId, message: &[u8], mappings: &Mappings) -> Result<Bytes, ConvertError> {
    let message = transcode(&mappings.to_ros2, message)?;
    let (header, rest) = message.split_at_checked(ENCAPSULATION).ok_or(ConvertError::Short)?;
    let mut message = [header, id, rest].concat();
    message.resize(message.len().next_multiple_of(4), 0);
    Ok(message.into())
}

fn transcode(mapping: &Mapping, message: &[u8]) -> Result<Vec<u8>, TranscodeError> {
    let mut output = Vec::new();
    mapping.transcode(message, &mut output, &Options::default())?;
    Ok(output)
}

#[cfg(test)]
#[path = "../tests/unit/actions.rs"]
mod tests;
