//! Names of types, in the spellings of ROS 1, ROS 2 and DDS.

use std::fmt;

use crate::Dialect;

/// Longest package or type name, in bytes.
pub const MAX_NAME: usize = 255;

/// What kind of file a type was defined in.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Kind {
    Message,
    Service,
    Action,
}

impl Kind {
    /// The folder of such files in a package, and the middle of a ROS 2 name.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Message => "msg",
            Self::Service => "srv",
            Self::Action => "action",
        }
    }

    pub(crate) fn from_folder(folder: &str) -> Option<Self> {
        [Self::Message, Self::Service, Self::Action].into_iter().find(|kind| kind.folder() == folder)
    }
}

/// The name of a message, or of what is made of a service or an action: `std_msgs/msg/String`,
/// `std_srvs/srv/SetBool_Request`. The same name for both dialects, which write it differently.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct TypeName {
    package: Box<str>,
    kind: Kind,
    name: Box<str>,
}

/// A text that names no type.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("`{0}` is not the name of a type: write package/Type or package/msg/Type, of letters, digits and underscores")]
pub struct NameError(pub String);

impl TypeName {
    /// # Errors
    /// For a package or a name that is not letters, digits and underscores behind a letter, or is
    /// longer than [`MAX_NAME`].
    pub fn new(package: &str, kind: Kind, name: &str) -> Result<Self, NameError> {
        if is_identifier(package) && is_identifier(name) {
            return Ok(Self { package: package.into(), kind, name: name.into() });
        }
        Err(NameError(excerpt(&format!("{package}/{name}"))))
    }

    /// Of a message of this package.
    pub(crate) fn message(package: &str, name: &str) -> Self {
        Self { package: package.into(), kind: Kind::Message, name: name.into() }
    }

    /// The name as ROS 1 (`std_msgs/String`), ROS 2 (`std_msgs/msg/String`) or DDS
    /// (`std_msgs::msg::dds_::String_`) writes it.
    ///
    /// # Errors
    /// For anything else.
    pub fn parse(text: &str) -> Result<Self, NameError> {
        let refused = || NameError(excerpt(text));
        if text.len() > 3 * MAX_NAME {
            return Err(refused());
        }
        if text.contains("::") {
            let mut parts = text.split("::");
            let (package, folder, between, name) = (parts.next(), parts.next(), parts.next(), parts.next());
            let (Some(package), Some(folder), Some("dds_"), Some(name), None) =
                (package, folder, between, name, parts.next())
            else {
                return Err(refused());
            };
            let name = name.strip_suffix('_').ok_or_else(refused)?;
            return Self::new(package, Kind::from_folder(folder).ok_or_else(refused)?, name).map_err(|_| refused());
        }
        let mut parts = text.split('/');
        let name = match (parts.next(), parts.next(), parts.next(), parts.next()) {
            (Some(package), Some(name), None, None) => Self::new(package, Kind::Message, name),
            (Some(package), Some(folder), Some(name), None) => {
                Self::new(package, Kind::from_folder(folder).ok_or_else(refused)?, name)
            }
            _ => return Err(refused()),
        };
        name.map_err(|_| refused())
    }

    /// Of request and response of the service with this package and name, whatever kind this name
    /// says.
    pub fn service_halves(&self) -> [Self; 2] {
        ["_Request", "_Response"].map(|half| self.with(Kind::Service, half))
    }

    pub fn package(&self) -> &str {
        &self.package
    }

    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Without package and kind.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// As this dialect's tools write it. ROS 1 leaves the kind out, and calls the halves of a
    /// service `std_srvs/SetBoolRequest` and `…Response`.
    pub fn display(&self, dialect: Dialect) -> String {
        match dialect {
            Dialect::Ros2 => self.to_string(),
            Dialect::Ros1 => match self.name.rsplit_once('_') {
                Some((service, half)) if self.kind == Kind::Service => format!("{}/{service}{half}", self.package),
                _ => format!("{}/{}", self.package, self.name),
            },
        }
    }

    /// As a ROS 2 participant of DDS announces it.
    pub fn dds(&self) -> String {
        format!("{}::{}::dds_::{}_", self.package, self.kind.folder(), self.name)
    }

    /// With `suffix` behind its name, and of this kind: what services and actions consist of.
    pub(crate) fn with(&self, kind: Kind, suffix: &str) -> Self {
        Self { package: self.package.clone(), kind, name: format!("{}{suffix}", self.name).into() }
    }

    /// Whether this is `package/Name` of messages.
    pub(crate) fn is_message(&self, package: &str, name: &str) -> bool {
        self.kind == Kind::Message && &*self.package == package && &*self.name == name
    }
}

/// The ROS 2 form, which says most.
impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.kind.folder(), self.name)
    }
}

/// Letters, digits and underscores behind a letter: names of packages, types and fields in both
/// dialects. Each dialect's compilers are stricter about case, but not always have been.
pub(crate) fn is_identifier(text: &str) -> bool {
    text.len() <= MAX_NAME
        && text.starts_with(|first: char| first.is_ascii_alphabetic())
        && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// So much of a text as an error may repeat.
pub(crate) fn excerpt(text: &str) -> String {
    const MOST: usize = 80;
    let mut excerpt: String = text.chars().take(MOST).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if text.chars().nth(MOST).is_some() {
        excerpt.push('…');
    }
    excerpt
}

#[cfg(test)]
#[path = "../tests/unit/name.rs"]
mod tests;
