//! A fabric that is on nobody's side, in one process over UDP on loopback, without root: a switch
//! of the tests' own making that hands every frame to the test before it sends it on, and a RIB
//! (the real one) whose every word the test may change before an entity hears it. What the switch
//! sends bears the right hop tags, so nothing but what is end to end stands in its way. It does not
//! ask who may send where: that is for switches that are honest (`hostile.rs`).
//!
//! ```text
//!   Node ──┐  requests ──► refuse_to_hear ──► Rib ──► lie ──► Node, Rogue
//!   Node ──┼─ Switch
//!   Rogue  ┘  frames ────► tamper ──► Node, Rogue
//! ```
//!
//! A [`Rogue`] is an entity without a node: it is at the switch itself, holds its own keys and
//! whatever it is given, and has the switch send what it likes. [`Owner`] gives out certificates.

mod owner;
mod rogue;
mod scene;
mod switch;

pub use owner::{Owner, serial};
pub use rogue::{Rogue, frames};
pub use scene::{Recording, Scene, drops};
pub use switch::{Frame, Switch};

use anyhow::Result;
use gdp::{Node, NodeConfig, NodeCounters};
use gdp_core::identity::Identity;
use gdp_e2e::seal::Message;
use gdp_tests::wait::{TIMEOUT, wait_for};

/// Waits for a condition with a deadline.
pub fn eventually<T>(what: &str, mut condition: impl FnMut() -> Option<T>) -> Result<T> {
    tokio::task::block_in_place(|| wait_for(what, TIMEOUT, || Ok(condition())))
}

/// A node of this identity at the switch.
pub async fn node(switch: &Switch, identity: &Identity) -> Result<Node> {
    Ok(Node::connect(NodeConfig::new(identity.clone(), switch.target())).await?)
}

/// How often a node dropped something for this reason.
pub fn dropped(counters: &NodeCounters, reason: &str) -> u64 {
    counters.drops.get(reason).copied().unwrap_or(0)
}

pub fn bodies(messages: &[Message]) -> Vec<&[u8]> {
    messages.iter().map(|message| &message.body[..]).collect()
}
