//! What stands for the DPDK plane in a build without it: nothing can be of this type.

use std::collections::HashMap;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use gdp_link::link::KeyedEntry;
use gdp_wire::{Counter, LinkEntry};

use super::{DeviceCounters, DpdkConfig, DpdkPlaneError};
use crate::forwarder_state::Shared;
use crate::tables::Reader;

pub struct DpdkPlane(Infallible);

impl DpdkPlane {
    pub fn start(
        _: &DpdkConfig,
        _: Option<PathBuf>,
        _: u16,
        _: impl FnMut() -> Reader,
        _: &Arc<Shared>,
    ) -> Result<Self, DpdkPlaneError> {
        Err(DpdkPlaneError::NotBuilt)
    }

    /// Says that only another build can.
    pub fn put_back_left(kept: &Path) {
        if kept.exists() {
            let path = kept.display();
            tracing::warn!(
                "interfaces are set as a daemon with DPDK has left them; one with it puts back what is in {path}"
            );
        }
    }

    pub fn device_of(&self, _: u32) -> Option<&str> {
        match self.0 {}
    }

    pub fn routes(&self, _: &LinkEntry) -> bool {
        match self.0 {}
    }

    pub fn follow<'l>(&mut self, _: Option<SocketAddr>, _: &[(u32, u16)], _: impl Iterator<Item = &'l KeyedEntry>) {
        match self.0 {}
    }

    pub fn follow_link(&mut self, _: &LinkEntry) {
        match self.0 {}
    }

    pub fn counters(&self) -> [u64; Counter::COUNT] {
        match self.0 {}
    }

    pub fn losses(&self) -> HashMap<String, u64> {
        match self.0 {}
    }

    pub fn devices(&self) -> HashMap<String, DeviceCounters> {
        match self.0 {}
    }

    pub fn processor_time(&self) -> Vec<Duration> {
        match self.0 {}
    }
}
