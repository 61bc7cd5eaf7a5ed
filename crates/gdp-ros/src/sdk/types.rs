//! Types of messages in Rust, and their CDR.

use std::sync::Arc;

use byteorder::{BigEndian, LittleEndian};
use gdp_msg::{Schema, TypeName};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::RosSdkError;
use crate::encoder::type_hash;
use crate::roster::{Dialect, Kind};
use crate::types::Types;

/// A ROS message type. Its serde fields have the order and types of the definition: for example
/// `Vec<T>` for `T[]`, `[T; N]` for `T[N]`, and `std::string::String` for `string`.
///
/// ```
/// #[derive(serde::Serialize, serde::Deserialize)]
/// struct Battery {
///     volts: f32,
///     cells: Vec<f32>,
/// }
///
/// impl gdp_ros::sdk::RosMessage for Battery {
///     const TYPE: &str = "my_robot/msg/Battery";
///     const DEFINITION: Option<&str> = Some("float32 volts\nfloat32[] cells\n");
/// }
/// ```
pub trait RosMessage: Serialize + DeserializeOwned + Send + Sync {
    /// The name of the type, such as `std_msgs/msg/String`.
    const TYPE: &str;
    /// The definition as in a `.msg` file, followed by those of nested types as `ros2 interface
    /// show` separates them. `None` for the common interfaces.
    const DEFINITION: Option<&str> = None;
}

/// Returns the type with its hash, and its definition.
pub(super) fn kind<T: RosMessage>(types: &Types) -> Result<(Kind, Arc<Schema>), RosSdkError> {
    let name = TypeName::parse(T::TYPE)?;
    let unknown = Kind { dialect: Dialect::Ros2, name: name.to_string(), hash: vec![] };
    let schema = types.schema(&unknown, T::DEFINITION);
    let schema = schema.map_err(|error| RosSdkError::Type(T::TYPE.into(), Box::new(error)))?;
    Ok((Kind { hash: type_hash(&schema), ..unknown }, schema))
}

/// Encodes a message in little-endian CDR, with its header.
pub(super) fn to_cdr<T: RosMessage>(message: &T) -> Result<Vec<u8>, RosSdkError> {
    let mut body = vec![0, 1, 0, 0];
    let written = cdr_encoding::to_writer::<_, LittleEndian, _>(&mut body, message);
    written.map_err(|error| RosSdkError::Cdr(T::TYPE.into(), error.to_string()))?;
    Ok(body)
}

/// Decodes a message with its header.
pub(super) fn from_cdr<T: RosMessage>(bytes: &[u8]) -> Result<T, RosSdkError> {
    let wrong = |error: String| RosSdkError::Cdr(T::TYPE.into(), error);
    let decoded = match bytes.split_first_chunk() {
        Some(([0, 0, _, _], body)) => cdr_encoding::from_bytes::<T, BigEndian>(body),
        Some(([0, 1, _, _], body)) => cdr_encoding::from_bytes::<T, LittleEndian>(body),
        _ => return Err(wrong("it has no header of plain CDR".into())),
    };
    decoded.map(|(message, _)| message).map_err(|error| wrong(error.to_string()))
}

/// Defines messages of the common interfaces.
macro_rules! messages {
    ($package:literal, $($(#[$doc:meta])* $name:ident { $($field:ident: $kind:ty),* $(,)? })*) => {
        $(
            $(#[$doc])*
            #[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
            #[allow(missing_docs, reason = "the fields are those of the definition")]
            pub struct $name {
                $(pub $field: $kind,)*
            }

            impl $crate::sdk::RosMessage for $name {
                const TYPE: &str = concat!($package, "/msg/", stringify!($name));
            }
        )*
    };
}

/// Messages of the package `builtin_interfaces`.
pub mod builtin_interfaces {
    messages! { "builtin_interfaces",
        /// A time since 1970.
        Time { sec: i32, nanosec: u32 }
        /// A span of time.
        Duration { sec: i32, nanosec: u32 }
    }
}

/// Messages of the package `std_msgs`.
pub mod std_msgs {
    messages! { "std_msgs",
        /// A text.
        String { data: std::string::String }
        /// True or false.
        Bool { data: bool }
        /// An integer of 32 bits.
        Int32 { data: i32 }
        /// An integer of 64 bits.
        Int64 { data: i64 }
        /// A number of double precision.
        Float64 { data: f64 }
        /// The time and the frame of a message.
        Header { stamp: super::builtin_interfaces::Time, frame_id: std::string::String }
    }
}

/// Messages of the package `geometry_msgs`.
pub mod geometry_msgs {
    messages! { "geometry_msgs",
        /// A direction.
        Vector3 { x: f64, y: f64, z: f64 }
        /// A point.
        Point { x: f64, y: f64, z: f64 }
        /// A rotation.
        Quaternion { x: f64, y: f64, z: f64, w: f64 }
        /// A position with a rotation.
        Pose { position: Point, orientation: Quaternion }
        /// A velocity.
        Twist { linear: Vector3, angular: Vector3 }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/sdk_types.rs"]
mod tests;
