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

/// A goal ID, which the client draws at random.
pub type GoalId = [u8; 16];

/// Time that an ended goal is remembered. It is the longest time that ROS 2 servers store results.
pub const LINGER: Duration = Duration::from_secs(900);
