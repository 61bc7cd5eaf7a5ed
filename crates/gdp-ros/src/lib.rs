//! How ROS messages travel in the Global Data Plane, for all who put them in or take them out:
//! [`roster`] is what is told of a topic beside its messages, [`catalog`] which names a proxy
//! exposes by itself, [`call`] what is said about a service or an action, [`action`] what is kept
//! of goals, [`names`] which texts name something in ROS, [`types`] makes one form of a message of
//! another, [`compression`] shorter ones. No I/O; no ROS graph either, which is the proxy's.
#![deny(unsafe_code)]
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod action;
pub mod call;
pub mod catalog;
pub mod compression;
pub mod names;
pub mod roster;
pub mod services;
pub mod types;
