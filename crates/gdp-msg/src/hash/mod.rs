//! Type hashes, which ROS compares to check that two nodes use the same type.

mod md5sum;
mod rihs01;

pub use md5sum::{md5sum, service_md5sum};
pub use rihs01::type_hash;
