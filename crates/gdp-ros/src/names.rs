//! Checks the names of topics, services, actions and types in ROS 2 (design.ros2.org, "Topic and
//! Service name mapping to DDS").
//!
//! These names come from users, cards and the network. Callers check them here before they use
//! them.

use gdp_util::escape::Escaped;

/// Maximum length of a name, in bytes. DDS vendors allow 256 bytes; the prefix `rt` takes two and
/// the terminator one.
const MAX_TOPIC: usize = 253;

/// Maximum length of a type name, in bytes.
const MAX_TYPE: usize = 253;

/// The reason why a text is not a ROS name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    #[error(
        "`{0}` is not a fully qualified topic name: write it with a leading slash, of letters, digits and underscores, \
         such as /chatter or /robot1/image_raw, at most {MAX_TOPIC} characters"
    )]
    Topic(String),
    #[error("`{0}` is not a message type: write it as package/msg/Name, such as std_msgs/msg/String")]
    Type(String),
}

impl NameError {
    pub fn of_type(text: &str) -> Self {
        Self::Type(excerpt(text))
    }
}

/// Checks a fully qualified name of a topic, service or action, such as `/robot1/image_raw`.
pub fn check_topic(text: &str) -> Result<(), NameError> {
    let tokens_are_good = text.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_identifier));
    if tokens_are_good && text.len() <= MAX_TOPIC { Ok(()) } else { Err(NameError::Topic(excerpt(text))) }
}

/// Checks a type name of a message, service or action, such as `std_srvs/srv/SetBool`. Returns the
/// middle part, here `srv`.
pub fn check_type(text: &str) -> Result<&str, NameError> {
    match text.split('/').collect::<Vec<_>>()[..] {
        [package, folder @ ("msg" | "srv" | "action"), name]
            if is_identifier(package) && is_identifier(name) && text.len() <= MAX_TYPE =>
        {
            Ok(folder)
        }
        _ => Err(NameError::of_type(text)),
    }
}

fn is_identifier(token: &str) -> bool {
    token.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && token.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// Returns the first 80 characters of `text`, escaped for an error message.
fn excerpt(text: &str) -> String {
    Escaped(text.chars().take(80).collect::<String>()).to_string()
}

#[cfg(test)]
#[path = "../tests/unit/names.rs"]
mod tests;
