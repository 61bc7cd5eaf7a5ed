//! What an endpoint of the Global Data Plane needs: names and name cards, identities, certificates, sealed messages,
//! links and sessions. This is the public SDK. State machines here take (now, input) and return outputs; only `link`
//! and what builds on it touch sockets. ROS is unknown here.

pub mod card;
pub mod cbor;
pub mod cert;
pub mod control;
pub mod crypto;
pub mod domain;
pub mod feedback_wire;
pub mod file_stamp;
pub mod identity;
pub mod keys;
pub mod link;
pub mod name;
pub mod node;
pub mod peers;
pub mod port;
pub mod revocations;
pub mod seal;
pub mod secret_file;
pub mod transport;
#[cfg(test)]
mod vectors;

pub use card::NameCard;
pub use identity::{Identity, SigningKey, VerifyKey};
pub use name::{Name, NamePrefix, NameProof};
pub use node::{Node, NodeConfig, NodeError};
