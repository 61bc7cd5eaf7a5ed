//! What proxies keep of the goals of an action: [`Goals`] remembers whose each is, [`Log`] what is
//! to be told to those who sent them, and [`Board`] shows what several servers say as if they were
//! one. [`cdr`] reads the few messages of actions that all actions share.

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
