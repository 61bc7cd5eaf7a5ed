//! The ROS generation that a definition is written for.

use std::fmt;

/// The ROS generation whose rules a definition follows.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Dialect {
    /// `time` and `duration` are built in, `byte` is signed, and `std_msgs/Header` has `seq`.
    Ros1,
    /// Strings and sequences can have bounds. `wstring` and default values exist; `byte` and `char`
    /// are `uint8`.
    Ros2,
}

impl fmt::Display for Dialect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ros1 => "ROS 1",
            Self::Ros2 => "ROS 2",
        })
    }
}
