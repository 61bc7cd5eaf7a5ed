//! Carries ROS topics, of ROS 1 and ROS 2, over the Global Data Plane, with the applications
//! unchanged.
//!
//! [`config`] says which topics; [`graph`] is the ROS graph they are of, and [`ros2`] the DDS
//! beneath it; [`route`] joins one topic to one name, in one direction, as `delivery` says, and
//! tells the other side by a roster (`gdp-ros`) what it carries, which is converted where it must
//! be; [`call`] does the same for services and actions; [`manager`] runs what is wanted of these,
//! [`proxy`] puts them together, [`reload`] notices that the file says something else, [`stats`]
//! counts. [`relay`] runs a switch of `gdp-ctl` beside, for others. The fabric is the SDK's
//! business (`gdp`): nothing here seals, signs or routes.
#![deny(unsafe_code)]
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod automatic;
pub mod call;
mod carries;
mod cert_file;
pub mod config;
mod delivery;
pub mod diagnostics;
pub mod dry_run;
pub mod graph;
pub mod manager;
pub mod material;
mod material_error;
mod membership;
mod offload;
pub mod peer_proxies;
mod permission;
pub mod proxy;
pub mod relay;
pub mod reload;
mod renewal;
pub mod ros2;
pub mod route;
mod route_material;
mod route_status;
pub mod routes;
pub mod stats;
mod tally;
pub mod timing;
mod turns;
