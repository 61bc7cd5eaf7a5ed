//! Names, name cards, identities, certificates, domains, wrapped keys and revocations of the Global
//! Data Plane.
//!
//! [`crypto`] encapsulates the cryptography. This crate has no sockets and no clock: callers pass
//! the time.
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod card;
pub mod cbor;
pub mod cert;
pub mod crypto;
pub mod domain;
pub mod file_kind;
pub mod identity;
pub mod keys;
pub mod link_target;
pub mod mac;
pub mod name;
pub mod peer;
pub mod revocations;
pub mod secret_file;
#[cfg(test)]
#[path = "../tests/unit/published_vectors.rs"]
mod vectors;
mod verify_key;
