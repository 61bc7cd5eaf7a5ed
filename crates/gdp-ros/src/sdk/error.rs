//! Errors of ROS messages in the SDK.

use gdp_core::cbor::CborError;
use gdp_msg::{LoadError, NameError, TranscodeError};

use crate::encoder::EncodeError;
use crate::feed::DecodeError;
use crate::types::TypeError;

/// Why a ROS topic cannot be published or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RosSdkError {
    /// The session refused.
    #[error(transparent)]
    Session(#[from] gdp::Error),
    /// A share folder cannot be read.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// The name of a type is not one of ROS.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A type is not known, or has no form that can be encoded.
    #[error("{0}: {1}")]
    Type(String, Box<TypeError>),
    /// The topic's name card states another type.
    #[error("{topic} is of {carded}, and not of {wanted}")]
    OtherType {
        /// The topic.
        topic: String,
        /// The type in the name's card, or of the publisher.
        carded: String,
        /// The type that the program uses.
        wanted: String,
    },
    /// A value does not fit its type.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// A message is none of its type.
    #[error(transparent)]
    Decode(#[from] DecodeError),
    /// A message of ROS 1 has no form in ROS 2.
    #[error(transparent)]
    Transcode(#[from] TranscodeError),
    /// A message is none of the type.
    #[error("a message that is no {0}: {1}")]
    Cdr(String, String),
    /// The list of publishers is too long.
    #[error(transparent)]
    Roster(#[from] CborError),
}
