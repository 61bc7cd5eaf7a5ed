//! The prefix of coordinate frame names.

use schemars::JsonSchema;
use serde::Deserialize;

/// Bound in bytes on a prefix, longer than any robot's name.
const MAX: usize = 128;

/// Text in front of coordinate frame names, such as `robot1/`. It is prepended unchanged.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(try_from = "String")]
pub struct FramePrefix(String);

impl FramePrefix {
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for FramePrefix {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let wrong = match text.as_str() {
            "" => "is empty; leave it out".into(),
            text if text.len() > MAX => format!("is longer than {MAX} bytes"),
            text if text.starts_with('/') => {
                "begins with a slash, which tf2 takes of no frame; write it as robot1/".into()
            }
            text if text.contains(|c: char| c.is_whitespace() || c.is_control()) => "has blanks in it".into(),
            _ => return Ok(Self(text)),
        };
        Err(format!("the frame_prefix {text:?} {wrong}"))
    }
}
