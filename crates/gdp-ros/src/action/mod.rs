//! State that proxies keep about the goals of an action. [`Goals`] remembers the owner of each
//! goal. [`Log`] queues events for the owners. [`Board`] merges the statuses of several servers.
//! [`cdr`] reads and writes the messages that all actions share.

mod board;
pub mod cdr;
mod goals;
mod log;

use std::time::Duration;

pub use board::Board;
pub use goals::{Goals, GoalsError};
pub use log::{Log, LogError};

/// A goal's number, drawn at random by whoever sends it.
pub type GoalId = [u8; 16];

/// How long a goal is remembered that has ended: as long as ROS 2's servers keep results at most.
pub const LINGER: Duration = Duration::from_secs(900);
