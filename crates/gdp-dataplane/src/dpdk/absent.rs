//! Replaces the DPDK plane in a build without the feature `dpdk`.

use std::path::Path;

use super::DpdkPlaneError;
use crate::config::PlaneConfig;
use crate::data_plane::FastPath;
use crate::userspace_plane::UserspacePlane;

pub fn start(_: &PlaneConfig, _: &UserspacePlane) -> Result<Box<dyn FastPath>, DpdkPlaneError> {
    Err(DpdkPlaneError::NotBuilt)
}

/// Logs that only a build with DPDK can restore the settings.
pub fn restore_settings(file: &Path) {
    if file.exists() {
        let path = file.display();
        tracing::warn!(
            "interfaces are set as a daemon with DPDK has left them; one with it puts back what is in {path}"
        );
    }
}
