//! Formats of the ROS messages that proxies exchange over the Global Data Plane.
//!
//! [`roster`] describes the publishers of a topic. [`catalog`] lists the names that a proxy
//! exposes. [`call`] frames the requests and replies of services and actions. [`action`] tracks
//! goals. [`actionlib`] has the protocol of ROS 1 for them. [`names`] validates ROS names, and
//! [`pattern`] patterns of them. [`qos_mapping`] maps QoS to the fabric. [`types`], [`services`]
//! and [`actions`] convert messages between types and encodings. [`compression`] compresses message
//! bodies. This crate does no I/O and holds no ROS graph; `gdp-proxy` and `gdp-ctl topic` do both.
#![deny(unsafe_code)]
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod action;
pub mod actionlib;
pub mod actions;
pub mod call;
pub mod catalog;
pub mod compression;
pub mod names;
pub mod pattern;
pub mod qos_mapping;
pub mod roster;
pub mod services;
pub mod types;
