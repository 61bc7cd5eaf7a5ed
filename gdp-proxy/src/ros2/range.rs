//! The range of ROS 2 discovery, from the environment.

/// Where others are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Range {
    /// On this host.
    Localhost,
    /// Where multicast goes.
    Subnet,
}

/// What the environment says cannot be done.
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
    /// As `rcl` reads it: ROS_LOCALHOST_ONLY, where it is 1, goes before
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
