//! Writes to BPF maps, with errors that name the map.

use crate::kernel_failures::UpdateError;
use aya::maps::MapError;

/// Ignores the error of removing a key that does not exist.
pub fn removed(result: Result<(), MapError>) -> Result<(), MapError> {
    match result {
        Err(MapError::KeyNotFound | MapError::ElementNotFound) => Ok(()),
        Err(MapError::SyscallError(error)) if error.io_error.raw_os_error() == Some(libc::ENOENT) => Ok(()),
        result => result,
    }
}

pub fn update(map: &'static str) -> impl Fn(MapError) -> UpdateError {
    move |source| UpdateError::Map { map, source }
}
