//! Encodes values of a type that is known by its name only, as CDR.

use std::sync::Arc;

use gdp_msg::{Encoding, Mapping, NameError, Options, Schema, TypeName};
use gdp_util::unix_time::unix_time;
use serde_json::Value;

use crate::fill::{FillError, fill};
use crate::roster::{Dialect, Kind};
use crate::types::{TypeError, Types};
use crate::user_input::UserInput;

/// Encodes values of one type of ROS 2.
pub struct Encoder {
    kind: Kind,
    schema: Arc<Schema>,
    mapping: Mapping,
}

/// Why a value cannot be encoded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The type's name is not one of ROS.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The type is not known.
    #[error("{0} is not known: {1}; name share folders that define it, such as /opt/ros/jazzy/share")]
    Unknown(TypeName, Box<TypeError>),
    /// The type cannot be encoded.
    #[error(transparent)]
    Map(#[from] gdp_msg::MapError),
    /// The value has other fields or types than the definition.
    #[error(transparent)]
    Fill(#[from] FillError),
    /// A value is out of the range of its field.
    #[error("`{path}`: {reason}")]
    Value {
        /// The field.
        path: String,
        /// What is wrong.
        reason: String,
    },
}

impl Encoder {
    /// Creates an encoder for a type such as `std_msgs/msg/String`.
    ///
    /// # Errors
    ///
    /// Fails if `types` does not have the type.
    pub fn new(types: &Types, type_name: &str) -> Result<Self, EncodeError> {
        let name = TypeName::parse(type_name)?;
        let mut kind = Kind { dialect: Dialect::Ros2, name: name.to_string(), hash: vec![] };
        let schema = types.schema(&kind, None).map_err(|error| EncodeError::Unknown(name, error.into()))?;
        kind.hash = type_hash(&schema);
        let mapping = Mapping::within(&schema, Encoding::Json, Encoding::Cdr)?;
        Ok(Self { kind, schema, mapping })
    }

    /// Returns the type.
    pub fn kind(&self) -> &Kind {
        &self.kind
    }

    /// Returns the definition of the type with all nested types.
    pub fn schema(&self) -> &Arc<Schema> {
        &self.schema
    }

    /// Encodes a message. Omitted fields have the default of the definition, or else are zero or
    /// empty. `now` in the input is the current time. Also returns all values.
    ///
    /// # Errors
    ///
    /// Fails if the input does not fit the definition.
    pub fn encode(&self, input: &UserInput) -> Result<(Vec<u8>, Value), EncodeError> {
        let now = unix_time();
        let values = fill(&self.schema, input, (now.as_secs(), now.subsec_nanos()))?;
        let mut body = Vec::new();
        // The position in the generated text would not help the user.
        self.mapping
            .transcode(values.to_string().as_bytes(), &mut body, &Options::default())
            .map_err(|error| EncodeError::Value { path: error.path.to_string(), reason: error.fault.to_string() })?;
        Ok((body, values))
    }
}

/// Returns the RIHS01 hash of a type, in bytes.
pub fn type_hash(schema: &Schema) -> Vec<u8> {
    let hash = gdp_msg::hash::type_hash(schema);
    hex::decode(hash.trim_start_matches("RIHS01_")).unwrap_or_default()
}
