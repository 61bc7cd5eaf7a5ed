//! Carries ROS topics, of ROS 1 and ROS 2, over the Global Data Plane, with the applications
//! unchanged.
//!
//! - [`config`] defines the topics, services and actions to carry.
//! - [`graph`] is the interface to a ROS graph, and [`ros2`] the DDS beneath it.
//! - [`route`] carries one topic under one name in one direction, with the options of `delivery`.
//!   It announces to the other side in a roster (`gdp-ros`) what it carries, and converts messages
//!   if the types differ.
//! - [`call`] does the same for services and actions.
//! - [`manager`] starts and ends the configured routes.
//! - [`proxy`] assembles these parts.
//! - [`reload`] reads the configuration again when it changes.
//! - [`stats`] counts messages and drops.
//! - [`metrics`] shows the counters to Prometheus.
//! - [`relay`] runs a switch of `gdp-ctl` beside the proxy, for other endpoints.
//!
//! The SDK (`gdp`) is the interface to the fabric: nothing here seals, signs or routes.
#![deny(unsafe_code)]
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod admin;
pub mod automatic;
pub mod call;
mod carries;
mod cert_file;
pub mod config;
pub mod diagnostics;
mod directory;
pub mod dry_run;
pub mod graph;
mod interfaces;
pub mod join;
pub mod manager;
pub mod material;
mod material_error;
pub mod metrics;
mod node_name;
mod offload;
pub mod peer_proxies;
mod permission;
pub mod proxy;
mod qos_mapping;
pub mod relay;
pub mod reload;
mod renewal;
pub mod ros2;
pub mod route;
mod route_material;
mod route_status;
pub mod routes;
mod silence;
pub mod stats;
mod tally;
pub mod timing;
mod turns;
mod waiting;
