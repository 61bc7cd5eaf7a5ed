//! A fabric with a malicious switch and RIB, in one process over UDP on loopback, without root. The
//! switch belongs to the tests and passes every frame to the test before forwarding it. The RIB is
//! the real one, but the test may change every update before an entity receives it. The switch's
//! frames have valid hop tags, so only end-to-end checks can stop them. The switch does not check
//! who may send where; tests of honest switches cover that (`hostile.rs`).
//!
//! ```text
//!   Node ──┐  requests ──► refuse_to_hear ──► Rib ──► lie ──► Node, Rogue
//!   Node ──┼─ Switch
//!   Rogue  ┘  frames ────► tamper ──► Node, Rogue
//! ```
//!
//! A [`Rogue`] is an entity without a node. It is attached to the switch directly, has its own keys
//! and whatever it receives, and lets the switch send arbitrary frames. [`Owner`] issues
//! certificates.

mod owner;
mod rogue;
mod scene;
mod switch;

pub use owner::{Owner, serial};
pub use rogue::{Rogue, frames};
pub use scene::{Recording, Scene, drops};
pub use switch::{Frame, Switch};

use anyhow::Result;
use gdp::unstable::{Node, NodeConfig, NodeCounters};
use gdp_core::identity::Identity;
use gdp_e2e::seal::Message;
use gdp_tests::wait::{TIMEOUT, wait_for};

/// Waits for a condition with a deadline.
pub fn eventually<T>(what: &str, mut condition: impl FnMut() -> Option<T>) -> Result<T> {
    tokio::task::block_in_place(|| wait_for(what, TIMEOUT, || Ok(condition())))
}

/// Connects a node of this identity to the switch.
pub async fn node(switch: &Switch, identity: &Identity) -> Result<Node> {
    Ok(Node::connect(NodeConfig::new(identity.clone(), switch.target())).await?)
}

/// Returns how many frames or messages a node dropped for this reason.
pub fn dropped(counters: &NodeCounters, reason: &str) -> u64 {
    counters.drops.get(reason).copied().unwrap_or(0)
}

pub fn bodies(messages: &[Message]) -> Vec<&[u8]> {
    messages.iter().map(|message| &message.body[..]).collect()
}
