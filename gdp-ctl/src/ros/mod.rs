//! Components of `gdp-ctl topic`, `service` and `action`. They are messages in the text forms of
//! ROS 2, and statistics of a topic. [`fabric`] and [`feed`] use the Global Data
//! Plane. The others perform no I/O. The commands are nodes of the
//! fabric, so they need no ROS graph.
//!
//! Output layouts are those of ros2cli and `rosidl_runtime_py`, for users and for scripts that
//! parse them.

pub mod fabric;
pub mod figures;
pub mod item;
pub mod python;
pub mod view;
pub mod yaml;

pub use gdp_ros::{feed, fill, user_input};

#[cfg(test)]
#[path = "../../tests/unit/ros.rs"]
mod tests;
