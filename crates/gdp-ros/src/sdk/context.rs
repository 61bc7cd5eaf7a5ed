//! The session and the definitions that handles of ROS messages need.

use std::path::PathBuf;

use gdp::Session;

use super::error::RosSdkError;
use crate::roster::Dialect;
use crate::types::Types;

/// A session, and share folders with definitions.
#[derive(Clone, Debug)]
pub struct RosContext {
    pub session: Session,
    pub definitions: Vec<PathBuf>,
}

impl RosContext {
    /// Loads the common interfaces, and the definitions in the folders.
    pub fn types(&self) -> Result<Types, RosSdkError> {
        Ok(Types::load(self.definitions.iter().map(|folder| (Dialect::Ros2, folder.as_path())))?)
    }
}
