//! Whether a call is a service or an action.

use crate::ros2::TypeName;
use serde::Serialize;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    Service,
    Action,
}

impl What {
    /// Returns the kind of its name card, which is also the key of its name in the configuration.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Service => "service",
            Self::Action => "action",
        }
    }

    /// Returns the list of the configuration that contains it.
    pub fn list(self) -> &'static str {
        match self {
            Self::Service => "services",
            Self::Action => "actions",
        }
    }

    pub fn folder(self) -> &'static str {
        match self {
            Self::Service => "srv",
            Self::Action => "action",
        }
    }

    /// Whether the type is a type of this kind.
    pub fn fits(self, kind: &TypeName) -> bool {
        kind.as_str().split('/').nth(1) == Some(self.folder())
    }
}
