//! The messages of an action in both dialects, and the mappings between them.
//!
//! ROS 1 wraps goal, result and feedback with a header and `actionlib_msgs`. ROS 2 wraps them with
//! a UUID in its services and topics. The wrappers differ, so the mappings are of what is inside.

use std::sync::Arc;

use crate::definition::{Base, Count, Definition, Field, Scalar, interface};
use crate::dialect::Dialect;
use crate::encode::Encoding;
use crate::mapping::{MapError, Mapping};
use crate::name::{InterfaceKind, TypeName};
use crate::registry::Registry;
use crate::schema::{Schema, SchemaError};

/// A part of an action that its author defines.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ActionPart {
    Goal,
    Result,
    Feedback,
}

/// The messages of one action in both dialects.
#[derive(Debug)]
pub struct Action {
    registry: Registry,
    /// Such as `nav2_msgs/action/Wait`.
    name: TypeName,
}

impl ActionPart {
    const ALL: [Self; 3] = [Self::Goal, Self::Result, Self::Feedback];

    fn as_str(self) -> &'static str {
        match self {
            Self::Goal => "Goal",
            Self::Result => "Result",
            Self::Feedback => "Feedback",
        }
    }

    /// Returns the name of the part's message.
    fn name(self, dialect: Dialect, action: &TypeName) -> TypeName {
        match dialect {
            Dialect::Ros1 => action.with(InterfaceKind::Message, self.as_str()),
            Dialect::Ros2 => action.with(InterfaceKind::Action, &format!("_{}", self.as_str())),
        }
    }
}

impl Action {
    /// Collects the messages of the action with this package and name. If only one dialect defines
    /// it, the messages of the other are made from that one.
    ///
    /// # Errors
    /// If neither dialect defines the action, or as [`Schema::resolve`].
    pub fn resolve(registry: &Registry, name: &TypeName) -> Result<Self, ActionError> {
        let is_known =
            |dialect| ActionPart::ALL.iter().all(|part| registry.get(dialect, &part.name(dialect, name)).is_some());
        let (ros1, ros2) = (is_known(Dialect::Ros1), is_known(Dialect::Ros2));
        if !ros1 && !ros2 {
            return Err(ActionError::Unknown(name.with(InterfaceKind::Action, "")));
        }
        let mut action = Self { registry: registry.clone(), name: name.with(InterfaceKind::Action, "") };
        if !ros1 {
            action.make(Dialect::Ros2, Dialect::Ros1)?;
        }
        if !ros2 {
            action.make(Dialect::Ros1, Dialect::Ros2)?;
        }
        action.wrap()?;
        Ok(action)
    }

    /// Makes the parts of one dialect from those of the other.
    fn make(&mut self, from: Dialect, to: Dialect) -> Result<(), SchemaError> {
        for part in ActionPart::ALL {
            let schema = Schema::resolve(&self.registry, from, &part.name(from, &self.name))?;
            let schema = schema.in_dialect(to, &self.registry)?;
            let root = Definition { name: part.name(to, &self.name), ..schema.root().clone() };
            self.registry.insert(to, schema.definitions().skip(1).cloned().chain([root]).collect())?;
        }
        Ok(())
    }

    /// Adds the messages that contain the parts.
    fn wrap(&mut self) -> Result<(), SchemaError> {
        self.registry.insert(Dialect::Ros1, interface::ros1_action(&self.name))?;
        self.registry.insert(Dialect::Ros2, interface::action(&self.name))?;
        // ROS 1 has no such message. It is the counterpart of the message that ROS 2 has.
        let status = Field::new(Base::Scalar(Scalar::Int8), Count::One, "status");
        let result = Base::Named(ActionPart::Result.name(Dialect::Ros1, &self.name));
        let fields = vec![status, Field::new(result, Count::One, "result")];
        let name = self.name.with(InterfaceKind::Message, RESULT_RESPONSE);
        Ok(self.registry.insert(Dialect::Ros1, vec![Definition { name, constants: Vec::new(), fields }])?)
    }

    pub fn name(&self) -> &TypeName {
        &self.name
    }

    /// Returns the ROS 1 message that contains the part, such as `pkg/DoActionGoal`.
    ///
    /// # Errors
    /// As [`Schema::resolve`].
    pub fn ros1(&self, part: ActionPart) -> Result<Arc<Schema>, SchemaError> {
        let name = self.name.with(InterfaceKind::Message, &format!("Action{}", part.as_str()));
        Schema::resolve(&self.registry, Dialect::Ros1, &name)
    }

    /// Returns the ROS 2 type of the whole action, such as `pkg/action/Do`. Its text defines all
    /// parts.
    ///
    /// # Errors
    /// As [`Schema::resolve`].
    pub fn ros2(&self) -> Result<Arc<Schema>, SchemaError> {
        Schema::resolve(&self.registry, Dialect::Ros2, &self.name)
    }

    /// Compiles a mapping of a part from one dialect's native encoding to the other's. The result
    /// has its status in front: in ROS 2 it is the response of `get_result`, and in ROS 1 an `int8`
    /// and the result.
    ///
    /// # Errors
    /// If the definitions of the dialects differ; or as [`Schema::resolve`].
    pub fn mapping(&self, part: ActionPart, from: Dialect) -> Result<Mapping, ActionError> {
        let schema = |dialect| {
            let name = match (part, dialect) {
                (ActionPart::Result, Dialect::Ros1) => self.name.with(InterfaceKind::Message, RESULT_RESPONSE),
                (ActionPart::Result, Dialect::Ros2) => self.name.with(InterfaceKind::Action, RESULT_RESPONSE),
                (part, dialect) => part.name(dialect, &self.name),
            };
            Schema::resolve(&self.registry, dialect, &name)
        };
        let (ros1, ros2) = (schema(Dialect::Ros1)?, schema(Dialect::Ros2)?);
        Ok(match from {
            Dialect::Ros1 => Mapping::new(&ros1, Encoding::Ros1, &ros2, Encoding::Cdr)?,
            Dialect::Ros2 => Mapping::new(&ros2, Encoding::Cdr, &ros1, Encoding::Ros1)?,
        })
    }

    /// Returns a ROS 1 result of zeros and empty texts and lists, in ROS 1 serialization.
    ///
    /// # Errors
    /// If such a result would be too large; or as [`Schema::resolve`].
    pub fn empty_result(&self) -> Result<Vec<u8>, ActionError> {
        let name = ActionPart::Result.name(Dialect::Ros1, &self.name);
        let to = Schema::resolve(&self.registry, Dialect::Ros1, &name)?;
        let from = Schema::from_text(Dialect::Ros1, &name, "")?;
        let mut empty = Vec::new();
        let mapping = Mapping::new(&from, Encoding::Ros1, &to, Encoding::Ros1)?;
        mapping.transcode(&[], &mut empty, &crate::Options { max_output: MAX_EMPTY, ..crate::Options::default() })?;
        Ok(empty)
    }
}

/// The suffix of the response of `get_result`.
const RESULT_RESPONSE: &str = "_GetResult_Response";

/// Maximum length of an empty result, in bytes. Only arrays of fixed length make it long.
const MAX_EMPTY: usize = 1 << 20;

/// The reason why messages of an action cannot be mapped.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum ActionError {
    #[error("there is no definition of {0} of either ROS version: give the share folder of its package")]
    Unknown(TypeName),
    #[error(transparent)]
    Schema(#[from] SchemaError),
    #[error(transparent)]
    Map(#[from] MapError),
    #[error("its empty result cannot be written: {0}")]
    Empty(#[from] crate::TranscodeError),
}
