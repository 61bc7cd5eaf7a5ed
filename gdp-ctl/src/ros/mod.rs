//! What `gdp-ctl topic`, `service` and `action` are made of: the user's keyring, messages as people
//! of ROS 2 read and write them, and the figures that are kept of a topic. [`fabric`] and [`feed`]
//! talk to the Global Data Plane; the others do no I/O but for the keyring's files. No ROS graph is
//! needed: the commands are a node of the fabric.
//!
//! Layouts are those of ros2cli and of `rosidl_runtime_py`, for people and for scripts that read
//! them.

pub mod fabric;
pub mod feed;
pub mod figures;
pub mod fill;
pub mod item;
pub mod keyring;
pub mod python;
pub mod user_input;
pub mod view;
pub mod yaml;

#[cfg(test)]
#[path = "../../tests/unit/ros.rs"]
mod tests;
