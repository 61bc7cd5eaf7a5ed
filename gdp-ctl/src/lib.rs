//! The daemon of the Global Data Plane and what its command line is made of: the RIB, the switch with its data planes,
//! the admin socket, the commands. A library so that tests reach all of it; the binary is a thin shell.

pub mod admin;
pub mod cli;
pub mod config;
pub mod crossing;
mod deadlines;
pub mod doctor;
pub mod domain;
mod feed;
pub mod folders;
pub mod plane;
pub mod rib;
pub mod ros;
pub mod serve;
pub mod store;
pub mod tiers;
pub mod topology;
mod unix_time;
