//! Text files of people, read whole and within a bound.

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _};
use std::os::unix::fs::{FileTypeExt as _, OpenOptionsExt as _};
use std::path::Path;

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
    let file = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path)?;
    let kind = file.metadata()?.file_type();
    if kind.is_fifo() || kind.is_socket() {
        let reason = "it is a pipe; write what comes out of it to a file, and name that";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    }
    Ok(file)
}

#[cfg(test)]
#[path = "../tests/unit/text_file.rs"]
mod tests;
