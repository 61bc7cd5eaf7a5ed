//! Formats of the ROS messages that proxies exchange over the Global Data Plane.
//!
//! [`roster`] describes the publishers of a topic. [`catalog`] lists the names that a proxy
//! exposes. [`call`] frames the requests and replies of services and actions. [`action`] tracks
//! goals. [`actionlib`] has the protocol of ROS 1 for them. [`names`] validates ROS names, and
//! [`pattern`] patterns of them. [`qos_mapping`] maps QoS to the fabric. [`types`], [`services`]
//! and [`actions`] convert messages between types and encodings. [`compression`] compresses message
//! bodies. [`fill`] and [`encoder`] make messages of values, and [`feed`] reads them from a topic.
//! [`sdk`] is for programs: `session.ros()`. This crate holds no ROS graph; `gdp-proxy` does.
#![deny(unsafe_code)]
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod action;
pub mod actionlib;
pub mod actions;
pub mod call;
pub use gdp_directory::catalog;

pub mod compression;
pub mod encoder;
pub mod feed;
pub mod fill;
pub mod names;
pub mod pattern;
pub mod qos_mapping;
pub mod roster;
pub mod sdk;
pub mod services;
pub mod types;
pub mod user_input;
