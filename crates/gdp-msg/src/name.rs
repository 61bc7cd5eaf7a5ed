//! Names of types, in the spellings of ROS 1, ROS 2 and DDS.

use std::fmt;

use crate::Dialect;

/// Maximum length of a package name or a type name, in bytes.
pub const MAX_NAME: usize = 255;

/// The kind of file that defines a type.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum InterfaceKind {
    Message,
    Service,
    Action,
}

impl InterfaceKind {
    /// Returns the folder of such files in a package, which is also the middle part of a ROS 2
    /// name.
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

/// The name of a message, or of a part of a service or action: `std_msgs/msg/String`,
/// `std_srvs/srv/SetBool_Request`. It is the same for both dialects, which write it differently.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct TypeName {
    package: Box<str>,
    kind: InterfaceKind,
    name: Box<str>,
}

/// The error for a text that is not a type name.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("`{0}` is not the name of a type: write package/Type or package/msg/Type, of letters, digits and underscores")]
pub struct NameError(pub String);

impl TypeName {
    /// Creates a name.
    ///
    /// # Errors
    /// If the package or the name is longer than [`MAX_NAME`]. Also if it does not consist of
    /// letters, digits and underscores after a letter.
    pub fn new(package: &str, kind: InterfaceKind, name: &str) -> Result<Self, NameError> {
        if is_identifier(package) && is_identifier(name) {
            return Ok(Self { package: package.into(), kind, name: name.into() });
        }
        Err(NameError(excerpt(&format!("{package}/{name}"))))
    }

    /// Returns the name of a message of this package.
    pub(crate) fn message(package: &str, name: &str) -> Self {
        Self { package: package.into(), kind: InterfaceKind::Message, name: name.into() }
    }

    /// Parses a name as ROS 1 (`std_msgs/String`), ROS 2 (`std_msgs/msg/String`) or DDS
    /// (`std_msgs::msg::dds_::String_`) writes it.
    ///
    /// # Errors
    /// If the text is not such a name.
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
            return Self::new(package, InterfaceKind::from_folder(folder).ok_or_else(refused)?, name)
                .map_err(|_| refused());
        }
        let mut parts = text.split('/');
        let name = match (parts.next(), parts.next(), parts.next(), parts.next()) {
            (Some(package), Some(name), None, None) => Self::new(package, InterfaceKind::Message, name),
            (Some(package), Some(folder), Some(name), None) => {
                Self::new(package, InterfaceKind::from_folder(folder).ok_or_else(refused)?, name)
            }
            _ => return Err(refused()),
        };
        name.map_err(|_| refused())
    }

    /// Returns the names of request and response of the service with this package and name. Ignores
    /// the kind of this name.
    pub fn service_halves(&self) -> [Self; 2] {
        ["_Request", "_Response"].map(|half| self.with(InterfaceKind::Service, half))
    }

    pub fn package(&self) -> &str {
        &self.package
    }

    pub fn kind(&self) -> InterfaceKind {
        self.kind
    }

    /// Returns the name without package and kind.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the name as this dialect's tools write it. ROS 1 omits the kind, and names the parts
    /// of a service `std_srvs/SetBoolRequest` and `…Response`.
    pub fn display(&self, dialect: Dialect) -> String {
        match dialect {
            Dialect::Ros2 => self.to_string(),
            Dialect::Ros1 => match self.name.rsplit_once('_') {
                Some((service, half)) if self.kind == InterfaceKind::Service => {
                    format!("{}/{service}{half}", self.package)
                }
                _ => format!("{}/{}", self.package, self.name),
            },
        }
    }

    /// Returns the name that a ROS 2 participant announces over DDS.
    pub fn dds(&self) -> String {
        format!("{}::{}::dds_::{}_", self.package, self.kind.folder(), self.name)
    }

    /// Returns the name with `suffix` and of this kind, for a part of a service or action.
    pub(crate) fn with(&self, kind: InterfaceKind, suffix: &str) -> Self {
        Self { package: self.package.clone(), kind, name: format!("{}{suffix}", self.name).into() }
    }

    /// Returns whether both dialects mean the same type by these names. ROS 1 writes `DoGoal` where
    /// ROS 2 writes `Do_Goal`.
    pub(crate) fn is_counterpart(&self, other: &Self) -> bool {
        let is_action = [self, other].iter().any(|name| name.kind == InterfaceKind::Action);
        let letters = |name: &Self| name.name.replace('_', "");
        self.package == other.package && (self.name == other.name || is_action && letters(self) == letters(other))
    }

    /// Returns whether this is the message `package/Name`.
    pub(crate) fn is_message(&self, package: &str, name: &str) -> bool {
        self.kind == InterfaceKind::Message && &*self.package == package && &*self.name == name
    }
}

/// Writes the ROS 2 form, which has the most information.
impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.kind.folder(), self.name)
    }
}

/// Returns whether a text is an identifier: letters, digits and underscores after a letter. Both
/// dialects use these for packages, types and fields. Their current compilers are stricter about
/// case; earlier ones were not.
pub(crate) fn is_identifier(text: &str) -> bool {
    text.len() <= MAX_NAME
        && text.starts_with(|first: char| first.is_ascii_alphabetic())
        && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

/// Returns the first 80 characters of a text for an error message, without control characters.
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
