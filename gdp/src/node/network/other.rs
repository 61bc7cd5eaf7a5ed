//! Systems that are not asked about their network.

use std::io;

use gdp_link::port::LinkAddr;
use tokio::sync::watch;

use super::NetworkPath;

/// The network of this machine, of which there is none to ask.
pub enum HostNetwork {}

impl HostNetwork {
    pub fn open(_: watch::Sender<()>) -> io::Result<Self> {
        Err(io::Error::new(io::ErrorKind::Unsupported, "only Linux is asked"))
    }

    pub fn changes(&self) -> watch::Receiver<()> {
        match *self {}
    }

    pub async fn way(&self, _: LinkAddr, _: Option<u32>) -> NetworkPath {
        match *self {}
    }

    pub async fn until_other(&self, _: LinkAddr, _: Option<u32>, _: &NetworkPath) -> NetworkPath {
        match *self {}
    }
}
