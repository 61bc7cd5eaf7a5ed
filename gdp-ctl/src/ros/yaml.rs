//! The values of a message as YAML, in the block style of `ros2 topic echo`.

use serde::ser::{Serialize, Serializer};
use serde_saphyr::ser::Error;

use crate::ros::item::Item;

/// Returns a document with a trailing line feed.
///
/// # Errors
/// If a value cannot be represented in YAML.
pub fn document(item: &Item) -> Result<String, Error> {
    // A text with line feeds is quoted on one line, so that it cannot imitate another message.
    serde_saphyr::to_string_with_options(item, serde_saphyr::ser_options! { prefer_block_scalars: false })
}

impl Serialize for Item {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Bool(value) => serializer.serialize_bool(*value),
            Self::Integer(value) => match i64::try_from(*value) {
                Ok(value) => serializer.serialize_i64(value),
                Err(_) => serializer.serialize_u64(u64::try_from(*value).map_err(serde::ser::Error::custom)?),
            },
            Self::Float(value) => serializer.serialize_f64(*value),
            Self::Text(value) => serializer.serialize_str(value),
            Self::List(items) => serializer.collect_seq(items),
            Self::Map(members) => serializer.collect_map(members.iter().map(|(name, item)| (name, item))),
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/ros/yaml.rs"]
mod tests;
