//! The SDK of the Global Data Plane: an endpoint publishes, subscribes, serves and calls names.
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod node;

pub use gdp_core::card::NameCard;
pub use gdp_core::identity::{Identity, SigningKey, VerifyKey};
pub use gdp_core::name::{Name, NamePrefix, NameProof};
pub use node::{Node, NodeConfig, NodeError};
