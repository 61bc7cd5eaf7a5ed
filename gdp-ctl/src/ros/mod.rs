//! Components of `gdp-ctl topic`, `service` and `action`. They are the user's keyring, messages in
//! the text forms of ROS 2, and statistics of a topic. [`fabric`] and [`feed`] use the Global Data
//! Plane. The others perform no I/O besides the keyring's files. The commands are nodes of the
//! fabric, so they need no ROS graph.
//!
//! Output layouts are those of ros2cli and `rosidl_runtime_py`, for users and for scripts that
//! parse them.

pub mod fabric;
pub mod feed;
pub mod figures;
pub mod fill;
pub mod item;
pub mod joined;
pub mod keyring;
pub mod members;
pub mod python;
pub mod user_input;
pub mod view;
pub mod yaml;

#[cfg(test)]
#[path = "../../tests/unit/ros.rs"]
mod tests;
