//! Text files of people, read whole and within a bound.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

use crate::os;

/// Reads a file of at most `max` bytes. Returns `None` if it is longer.
///
/// # Errors
///
/// Fails if the file cannot be read, is no UTF-8, or is a FIFO, which may have no writer and so
/// never end.
pub fn read(path: &Path, max: u64) -> io::Result<Option<String>> {
    let mut text = String::new();
    let length = open(path)?.take(max.saturating_add(1)).read_to_string(&mut text)? as u64;
    Ok((length <= max).then_some(text))
}

/// Opens a file without waiting for a writer.
fn open(path: &Path) -> io::Result<File> {
    let file = os::open_for_reading(path)?;
    if os::is_pipe(&file.metadata()?) {
        let reason = "it is a pipe; write what comes out of it to a file, and name that";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    Ok(file)
}

#[cfg(test)]
#[path = "../tests/unit/text_file.rs"]
mod tests;
