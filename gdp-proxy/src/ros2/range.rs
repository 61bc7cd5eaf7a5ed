//! The range of ROS 2 discovery, from the environment.

/// The range of discovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Range {
    /// Discovery is limited to this host.
    Localhost,
    /// Discovery reaches as far as multicast.
    Subnet,
}

/// Errors of a configured range that the proxy does not support.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum RangeError {
    #[error("ROS_AUTOMATIC_DISCOVERY_RANGE is {0:?}: write LOCALHOST, SUBNET or SYSTEM_DEFAULT")]
    Unknown(String),
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: a proxy finds its topics by discovery, and has no static peers; write \
         LOCALHOST, or take the \
         graph out of the configuration"
    )]
    Off,
}

impl Range {
    /// Reads the environment as `rcl` does: ROS_LOCALHOST_ONLY=1 has precedence over
    /// ROS_AUTOMATIC_DISCOVERY_RANGE.
    pub fn from_variables(variable: impl Fn(&str) -> Option<String>) -> Result<Self, RangeError> {
        if variable("ROS_LOCALHOST_ONLY").as_deref() == Some("1") {
            return Ok(Self::Localhost);
        }
        match variable("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
            Some("LOCALHOST") => Ok(Self::Localhost),
            None | Some("" | "SUBNET" | "SYSTEM_DEFAULT") => Ok(Self::Subnet),
            Some("OFF") => Err(RangeError::Off),
            Some(other) => Err(RangeError::Unknown(other.to_owned())),
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros2/range.rs"]
mod tests;
