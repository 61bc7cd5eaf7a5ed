//! A graph of ROS 2 nodes with rmw_zenoh. It needs the feature `zenoh`.

#[cfg(feature = "zenoh")]
mod calls;
#[cfg(feature = "zenoh")]
mod joined;
#[cfg(feature = "zenoh")]
mod publishers;
#[cfg(feature = "zenoh")]
mod reader;
#[cfg(not(feature = "zenoh"))]
mod stub;
#[cfg(feature = "zenoh")]
mod view;
#[cfg(feature = "zenoh")]
mod writer;

#[cfg(feature = "zenoh")]
pub use self::{
    calls::{ZenohClient, ZenohFeed, ZenohReply, ZenohServer},
    joined::{ZenohGraph, check},
    reader::ZenohReader,
    writer::ZenohWriter,
};
#[cfg(not(feature = "zenoh"))]
pub use stub::{ZenohClient, ZenohFeed, ZenohGraph, ZenohReader, ZenohReply, ZenohServer, ZenohWriter, check};
